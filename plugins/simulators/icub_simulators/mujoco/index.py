"""Where things stand in the arrays of a compiled model, looked up once."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from icub_core.robot_description import RobotDescription
from icub_core.scene import Scene
from icub_simulators.limits import FASTEST_JOINT, FASTEST_OBJECT, FASTEST_SPIN
from icub_simulators.mujoco.builder import OBJECT_PREFIX, TABLE_BODY, LinkFrames
from icub_simulators.mujoco.collision import ROBOT
from icub_simulators.mujoco.robot_spec import link_of_geom

IntArray = NDArray[np.intp]
Indexer = IntArray | slice


@dataclass(frozen=True, eq=False)
class ObjectSlots:
    """One object's place: 7 numbers of qpos, 6 of qvel."""

    body: int
    qpos: slice
    qvel: slice


@dataclass(frozen=True, eq=False)
class LinkSlot:
    """A link's place: the body that carries it and T_body_link (4, 4), None for the body itself."""

    body: int
    offset: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class Index:
    """Places in a model.

    Attributes:
        qpos, qvel: Of the robot's joints in the description's order; a slice where they are contiguous.
        lengths: (A, b): actuator lengths are A q + b.
        links: By name.
        robot_bodies: Bodies that move with the robot's joints.
        objects: By object name.
        object_of_geom: (ngeom,) index into the scene's objects, -1 for the rest.
        robot_geom: (ngeom,) bool.
        fingertip_of_geom: By hand: (ngeom,) 0..4 for thumb to little, -1 for the rest.
        velocity_limits: (nv,) speed beyond which nothing physical moves, rad/s and m/s.
    """

    qpos: Indexer
    qvel: Indexer
    lengths: tuple[NDArray[np.float64], NDArray[np.float64]]
    links: dict[str, LinkSlot]
    robot_bodies: tuple[int, ...]
    objects: dict[str, ObjectSlots]
    object_of_geom: NDArray[np.int32]
    robot_geom: NDArray[np.bool_]
    fingertip_of_geom: dict[str, NDArray[np.int8]]
    velocity_limits: NDArray[np.float64]


def build_index(model: mujoco.MjModel, frames: LinkFrames, robot: RobotDescription | None, scene: Scene) -> Index:
    """Find the addresses of joints, actuators, links, objects and fingertips in a compiled model."""
    joints = robot.joint_names if robot is not None else ()
    others = (TABLE_BODY, *(OBJECT_PREFIX + item.name for item in scene.objects))
    links = {
        link: LinkSlot(int(model.body(body).id), offset)
        for link, (body, offset) in frames.items()
        if link not in others
    }
    limits = np.full(model.nv, FASTEST_JOINT)
    objects = {}
    object_of_geom = np.full(model.ngeom, -1, np.int32)
    for number, item in enumerate(scene.objects):
        body = model.body(OBJECT_PREFIX + item.name)
        start, first = int(model.jnt_qposadr[body.jntadr[0]]), int(body.dofadr[0])
        objects[item.name] = ObjectSlots(int(body.id), slice(start, start + 7), slice(first, first + 6))
        object_of_geom[model.geom_bodyid == body.id] = number
        limits[first : first + 3], limits[first + 3 : first + 6] = FASTEST_OBJECT, FASTEST_SPIN
    carriers = [link_of_geom(model.geom(i).name) for i in range(model.ngeom)]
    tips = {}
    for hand in robot.hands.values() if robot is not None else ():
        names = hand.fingertips
        tips[hand.name] = np.array([names.index(link) if link in names else -1 for link in carriers], np.int8)
    n = len(joints)
    return Index(
        qpos=_indexer([int(model.joint(name).qposadr[0]) for name in joints]),
        qvel=_indexer([int(model.joint(name).dofadr[0]) for name in joints]),
        lengths=robot.actuator_matrix() if robot is not None else (np.zeros((0, n)), np.zeros(0)),
        links=links,
        robot_bodies=tuple(sorted({slot.body for slot in links.values()} - {0})),
        objects=objects,
        object_of_geom=object_of_geom,
        robot_geom=model.geom_contype == ROBOT,
        fingertip_of_geom=tips,
        velocity_limits=limits,
    )


def _indexer(places: list[int]) -> Indexer:
    """Return a slice, whose reading is a view, when the places follow each other; else an index array."""
    if places and places == list(range(places[0], places[0] + len(places))):
        return slice(places[0], places[0] + len(places))
    return np.array(places, dtype=np.intp)
