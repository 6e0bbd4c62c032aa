"""The open hand and the forearm as spheres, read from the robot's own description."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import FloatArray, invert, make_transform, rotation_about
from icub_core.interfaces.robot import Robot
from icub_grasp_generators.planned_hand import PlannedHand, planned_hand

_SPACING = 0.008  # meters between spheres along a link
_CELL = 0.004  # meters, edge of a cell of the occupancy grid


@dataclass(frozen=True, eq=False)
class Spheres:
    """Spheres that cover a body.

    Attributes:
        centers: (K, 3) meters, in the frame that the owner states.
        radii: (K,) meters.
    """

    centers: FloatArray
    radii: FloatArray

    def at(self, T: FloatArray) -> FloatArray:
        """Return the centers (..., K, 3) after the transforms `T` (..., 4, 4)."""
        return self.centers @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


class Occupancy:
    """The space inside a set of spheres, as a grid that many points are looked up in at once.

    Args:
        spheres: The body, in its own frame.
    """

    def __init__(self, spheres: Spheres) -> None:
        reach = spheres.radii[:, None]
        self._low = (spheres.centers - reach).min(axis=0) - _CELL
        count = np.ceil(((spheres.centers + reach).max(axis=0) + _CELL - self._low) / _CELL).astype(int)
        axes = [self._low[i] + (np.arange(count[i]) + 0.5) * _CELL for i in range(3)]
        cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        inside = np.zeros(len(cells), dtype=bool)
        for center, radius in zip(spheres.centers, spheres.radii, strict=True):
            inside |= ((cells - center) ** 2).sum(axis=1) < radius**2
        # one empty layer around the grid catches every point outside of it
        self._grid = np.pad(inside.reshape(tuple(count)), 1)

    def count(self, T: FloatArray, points: FloatArray) -> NDArray[np.intp]:
        """Count how many points (N, 3) lie inside the body placed at each of the poses T (C, 4, 4): (C,)."""
        local = (points - T[:, None, :3, 3]) @ T[:, :3, :3]
        index = np.floor((local - self._low) / _CELL).astype(np.intp) + 1
        index = np.clip(index, 0, np.array(self._grid.shape) - 1)
        return self._grid[index[..., 0], index[..., 1], index[..., 2]].sum(axis=1)


@dataclass(frozen=True, eq=False)
class HandGeometry:
    """What of a robot comes near the object and the table.

    Attributes:
        name: Of the hand.
        frame: The hand frame that grasps are stated in.
        reach: Joint group that places it.
        hand: The hand as it waits before a grasp (the home pose of its fingers), in the hand frame.
        occupancy: The same as a grid.
        planned: How poses of the hand are drawn.
        planned_body: The same as `hand`, in the frame in which poses are drawn.
        forearm_link: The last link above the hand that has a collision body, or None.
        forearm: That body in its link's frame; empty without such a link.
    """

    name: str
    frame: str
    reach: str
    hand: Spheres
    occupancy: Occupancy
    planned: PlannedHand
    planned_body: Spheres
    forearm_link: str | None
    forearm: Spheres


def read_hand_geometry(robot: Robot, hand: str | None = None) -> HandGeometry:
    """Collect the collision bodies of one hand, the robot's first by default, at the home pose.

    Raises:
        ConfigError: The robot has no such hand, or its description does not say where the hand holds.
    """
    description = robot.description
    chosen, planned = description.hand(hand), planned_hand(description, hand)
    frame = chosen.frame
    root = ET.parse(description.urdf).getroot()
    bodies = {link.attrib["name"]: _spheres_of(link) for link in root.findall("link")}
    parent = {j.find("child").attrib["link"]: j.find("parent").attrib["link"] for j in root.findall("joint")}  # type: ignore[union-attr]

    palm = frame
    while palm in parent and bodies[palm] is None:
        palm = parent[palm]
    forearm = parent.get(palm)
    while forearm is not None and bodies[forearm] is None:
        forearm = parent.get(forearm)

    q = description.home_q
    T_hand_world = invert(robot.forward_kinematics(q, frame))
    centers, radii = [], []
    for link, spheres in bodies.items():
        if spheres is not None and _is_below(link, palm, parent):
            centers.append(spheres.at(T_hand_world @ robot.forward_kinematics(q, link)))
            radii.append(spheres.radii)
    arm = bodies[forearm] if forearm is not None else None
    spheres = Spheres(np.concatenate(centers), np.concatenate(radii))
    return HandGeometry(
        name=chosen.name,
        frame=frame,
        reach=chosen.reach,
        hand=spheres,
        occupancy=Occupancy(spheres),
        planned=planned,
        planned_body=Spheres(planned.from_hand(spheres.centers), spheres.radii),
        forearm_link=forearm,
        forearm=arm if arm is not None else Spheres(np.zeros((0, 3)), np.zeros(0)),
    )


def _is_below(link: str, ancestor: str, parent: dict[str, str]) -> bool:
    while link != ancestor:
        if link not in parent:
            return False
        link = parent[link]
    return True


def _spheres_of(link: ET.Element) -> Spheres | None:
    """Cover the boxes, cylinders (as capsules) and spheres of a link; None if it has none. Meshes are passed over."""
    centers, radii = [], []
    for collision in link.findall("collision"):
        geometry = collision.find("geometry")
        if geometry is None or len(geometry) == 0:
            continue
        T = _origin(collision.find("origin"))
        shape = geometry[0]
        if shape.tag == "box":
            half = np.array([float(v) for v in shape.attrib["size"].split()]) / 2
            radius = float(half.min())
            axes = [
                np.linspace(-1, 1, max(2, int(np.ceil(2 * (h - radius) / _SPACING)) + 1)) * (h - radius) for h in half
            ]
            axes = [a if h > radius + 1e-4 else np.zeros(1) for a, h in zip(axes, half, strict=True)]
            local = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        elif shape.tag in ("cylinder", "capsule"):
            radius, length = float(shape.attrib["radius"]), float(shape.attrib["length"])
            z = np.linspace(-length / 2, length / 2, max(2, int(np.ceil(length / _SPACING)) + 1))
            local = np.stack([np.zeros_like(z), np.zeros_like(z), z], axis=1)
        elif shape.tag == "sphere":
            radius, local = float(shape.attrib["radius"]), np.zeros((1, 3))
        else:
            continue
        centers.append(local @ T[:3, :3].T + T[:3, 3])
        radii.append(np.full(len(local), radius))
    return Spheres(np.concatenate(centers), np.concatenate(radii)) if centers else None


def _spaced(half: float) -> FloatArray:
    """Positions from -half to half, close enough for spheres to overlap; one in the middle for no length."""
    return np.linspace(-half, half, max(2, int(np.ceil(2 * half / _SPACING)) + 1)) if half > 1e-4 else np.zeros(1)


def _origin(element: ET.Element | None) -> FloatArray:
    if element is None:
        return np.eye(4)
    xyz = [float(v) for v in element.attrib.get("xyz", "0 0 0").split()]
    roll, pitch, yaw = (float(v) for v in element.attrib.get("rpy", "0 0 0").split())
    return make_transform(rotation_about("z", yaw) @ rotation_about("y", pitch) @ rotation_about("x", roll), xyz)
