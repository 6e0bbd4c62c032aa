"""A claw of three fingers that hangs from a gantry: three slides, then yaw, pitch and roll.

Neither its sizes nor its names are the iCub's: what holds for it holds for any hand.
"""

from __future__ import annotations

import functools
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from icub_core.errors import ConfigError, unknown_name
from icub_core.files import write_text_atomically
from icub_core.geometry import FloatArray, invert, look_at, make_transform, matrix_to_quat_wxyz, rotation_log
from icub_core.interfaces.robot import IkSolution, Robot
from icub_core.robot_description import Actuator, Grip, HandDescription, JointDynamics, RobotCamera, RobotDescription

HAND_FRAME = "tiny_hand"
CAMERA = "tiny_camera"
HAND = "claw"
FINGERS = {"left": (0.05, -0.03, 0.0), "right": (0.05, 0.03, 0.0), "rear": (-0.05, 0.0, 0.0)}
"""Where each finger begins, meters in the hand's frame."""
ACTUATORS: dict[str, dict[str, float]] = {
    "claw_spread": {"rear_turn": 1.0},
    "claw_front": {"left_proximal": 1.0, "left_distal": 1.0, "right_proximal": 1.0, "right_distal": 1.0},
    "claw_rear_proximal": {"rear_proximal": 1.0},
    "claw_rear_distal": {"rear_distal": 1.0},
}
"""Actuator to what it pulls; the two front fingers share a tendon."""
PHALANX = 0.03
PALM = (0.08, 0.08, 0.02)
HOME = {"gantry_x": -0.2, "gantry_z": 1.35, "gantry_roll": np.pi}
"""In front of the robot above the table, palm (hand z) down."""


@dataclass(frozen=True)
class _Link:
    """One link with the joint that carries it; `kind` is prismatic, revolute or fixed."""

    name: str
    parent: str
    joint: str
    kind: str
    axis: tuple[float, float, float]
    offset: tuple[float, float, float]
    range: tuple[float, float]
    box: tuple[float, float, float] | None = None
    box_center: tuple[float, float, float] = (0.0, 0.0, 0.0)


def _links() -> tuple[_Link, ...]:
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    origin = (0.0, 0.0, 0.0)
    links = [
        _Link("tiny_x", "tiny_base", "gantry_x", "prismatic", x, origin, (-1.2, 0.0)),
        _Link("tiny_y", "tiny_x", "gantry_y", "prismatic", y, origin, (-1.0, 1.0)),
        _Link("tiny_z", "tiny_y", "gantry_z", "prismatic", z, origin, (0.5, 2.0)),
        _Link("tiny_yaw", "tiny_z", "gantry_yaw", "revolute", z, origin, (-3.3, 3.3)),
        _Link("tiny_pitch", "tiny_yaw", "gantry_pitch", "revolute", y, origin, (-1.6, 1.6)),
        _Link(HAND_FRAME, "tiny_pitch", "gantry_roll", "revolute", x, origin, (-3.3, 3.3), PALM),
    ]
    bone = (PHALANX, 0.014, 0.014)
    middle = (PHALANX / 2, 0.0, 0.0)
    for finger, place in FINGERS.items():
        carrier = HAND_FRAME
        if finger == "rear":  # turns first, then flexes
            links.append(_Link("rear_base", carrier, "rear_turn", "revolute", z, place, (0.0, 1.6)))
            carrier, place = "rear_base", origin
        for part, start in (("proximal", place), ("distal", (PHALANX, 0.0, 0.0))):
            # fingers bend towards the palm's +z
            links.append(
                _Link(
                    f"{finger}_{part}_link",
                    carrier,
                    f"{finger}_{part}",
                    "revolute",
                    (0.0, -1.0, 0.0),
                    start,
                    (0.0, 1.6),
                    bone,
                    middle,
                )
            )
            carrier = f"{finger}_{part}_link"
    return tuple(links)


LINKS = _links()


def _urdf() -> str:
    inertial = (
        "<inertial><mass value='{m}'/><inertia ixx='1e-4' ixy='0' ixz='0' iyy='1e-4' iyz='0' izz='1e-4'/></inertial>"
    )
    parts = ["<robot name='tiny'>", "<link name='tiny_base'/>"]
    for link in LINKS:
        body = ""
        if link.box is not None:
            size, center = (" ".join(map(str, v)) for v in (link.box, link.box_center))
            shape = f"<origin xyz='{center}'/><geometry><box size='{size}'/></geometry>"
            body = f"<visual>{shape}</visual><collision>{shape}</collision>"
        mass = 0.02 if link.name.endswith("_link") else 0.3
        parts.append(f"<link name='{link.name}'>{inertial.format(m=mass)}{body}</link>")
        parts.append(
            f"<joint name='{link.joint}' type='{link.kind}'><parent link='{link.parent}'/><child link='{link.name}'/>"
            f"<origin xyz='{' '.join(map(str, link.offset))}'/><axis xyz='{' '.join(map(str, link.axis))}'/>"
            f"<limit lower='{link.range[0]}' upper='{link.range[1]}' effort='1000' velocity='10'/></joint>"
        )
    return "\n".join([*parts, "</robot>"]) + "\n"


def _actuators() -> tuple[Actuator, ...]:
    made = [
        Actuator(link.joint, {link.joint: 1.0}, 400.0, link.range) for link in LINKS if link.joint.startswith("gantry")
    ]
    for name, coefficients in ACTUATORS.items():
        upper = 1.6 * len(coefficients)
        made.append(Actuator(name, coefficients, 2.0, (0.0, upper), open=0.1, close=0.6 * upper, step=0.1 * upper))
    return tuple(made)


@functools.cache
def _urdf_file() -> Path:
    """Write the robot's file once per process; loaders need one on disk."""
    path = Path(_folder().name) / "tiny.urdf"
    write_text_atomically(path, _urdf())
    return path


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="icub-tiny-")


def _describe() -> RobotDescription:
    joints = tuple(link.joint for link in LINKS)
    gantry = tuple(j for j in joints if j.startswith("gantry"))
    fingers = tuple(j for j in joints if not j.startswith("gantry"))
    return RobotDescription(
        name="tiny",
        urdf=_urdf_file(),
        T_world_root=np.eye(4),
        joint_names=joints,
        lower=np.array([link.range[0] for link in LINKS]),
        upper=np.array([link.range[1] for link in LINKS]),
        groups={"gantry": gantry, "fingers": fingers},
        actuators=_actuators(),
        home=HOME,
        hands={
            HAND: HandDescription(
                name=HAND,
                frame=HAND_FRAME,
                reach="gantry",
                actuators=tuple(ACTUATORS),
                fingertips=tuple(f"{finger}_distal_link" for finger in FINGERS),
                grip=Grip(
                    T_hand_grip=make_transform(None, [0.0, 0.0, PALM[2] / 2]),
                    width=0.08,
                    fingers_y=np.array([-0.03, 0.03]),
                    depth=0.03,
                    sweep=np.array([[-0.05, 0.05], [-0.04, 0.04], [0.0, 0.06]]),
                ),
            )
        },
        cameras=(_camera(),),
        dynamics={
            link.joint: JointDynamics(damping=40.0 if link.joint.startswith("gantry") else 0.1) for link in LINKS
        },
        contact_excludes=tuple((HAND_FRAME, link.name) for link in LINKS if link.name.endswith("_link")),
    )


def _camera() -> RobotCamera:
    place, aim = (0.3, 0.0, 1.6), (-0.35, 0.0, 0.95)
    w, x, y, z = (float(v) for v in matrix_to_quat_wxyz(look_at(place, aim)[:3, :3]))
    return RobotCamera(CAMERA, "tiny_base", place, (w, x, y, z), 0.8)


class TinyRobot(Robot):
    """A hand on a gantry, whose inverse kinematics has a closed form."""

    def __init__(self) -> None:
        """Describe the robot."""
        self._description = _describe()
        self._index = {link.name: i for i, link in enumerate(LINKS)}

    @property
    def description(self) -> RobotDescription:
        """The robot as data."""
        return self._description

    def _chain(self, frame: str) -> list[int]:
        chain = []
        while frame != "tiny_base":
            if frame not in self._index:
                raise ConfigError(unknown_name("frame of robot 'tiny'", frame, ["tiny_base", *self._index]))
            chain.append(self._index[frame])
            frame = LINKS[chain[-1]].parent
        return chain[::-1]

    def forward_kinematics(self, q: FloatArray, frame: str) -> FloatArray:
        """Multiply the transforms of the chain."""
        T = np.eye(4)
        for i in self._chain(frame):
            T = T @ _joint_transform(LINKS[i], float(q[i]))
        return T

    def link_poses(self, q: FloatArray) -> dict[str, FloatArray]:
        """Return T_world_link of every link in one pass."""
        poses = {"tiny_base": np.eye(4)}
        for i, link in enumerate(LINKS):  # parents come first
            poses[link.name] = poses[link.parent] @ _joint_transform(link, float(q[i]))
        return poses

    def jacobian(self, q: FloatArray, frame: str) -> FloatArray:
        """Collect one column per joint of the chain: its axis, and the axis crossed with the arm."""
        J = np.zeros((6, len(LINKS)))
        tip = self.forward_kinematics(q, frame)[:3, 3]
        T = np.eye(4)
        for i in self._chain(frame):
            T = T @ _joint_transform(LINKS[i], float(q[i]))
            axis = T[:3, :3] @ np.asarray(LINKS[i].axis)
            if LINKS[i].kind == "prismatic":
                J[:3, i] = axis
            else:
                J[:3, i], J[3:, i] = np.cross(axis, tip - T[:3, 3]), axis
        return J

    def inverse_kinematics(
        self,
        T_world_frame: FloatArray,
        q_start: FloatArray,
        frame: str,
        *,
        group: str | None = None,
        max_iterations: int = 100,
        position_tolerance: float = 1e-3,
        orientation_tolerance: float = 1e-2,
    ) -> IkSolution:
        """Read slides and angles off the wanted pose, then clip them to the limits."""
        self._description.indices(group or self._description.reach_group(frame))
        q = np.clip(q_start, self._description.lower, self._description.upper)
        if not np.all(np.isfinite(T_world_frame)):
            return IkSolution(q, False, np.inf, np.inf)
        # the frame may hang below the hand: what lies between does not move
        T_hand_frame = invert(self.forward_kinematics(q, HAND_FRAME)) @ self.forward_kinematics(q, frame)
        T = T_world_frame @ invert(T_hand_frame)
        pitch = np.arctan2(-T[2, 0], np.hypot(T[0, 0], T[1, 0]))
        if np.hypot(T[0, 0], T[1, 0]) > 1e-9:
            yaw, roll = np.arctan2(T[1, 0], T[0, 0]), np.arctan2(T[2, 1], T[2, 2])
        else:  # yaw and roll turn about the same axis
            yaw, roll = 0.0, np.arctan2(-T[1, 2], T[1, 1])
        wanted = np.concatenate([T[:3, 3], [yaw, pitch, roll]])
        q[:6] = np.clip(wanted, self._description.lower[:6], self._description.upper[:6])
        reached = self.forward_kinematics(q, frame)
        position_error = float(np.linalg.norm(reached[:3, 3] - T_world_frame[:3, 3]))
        orientation_error = float(np.linalg.norm(rotation_log(reached[:3, :3].T @ T_world_frame[:3, :3])))
        on_limit = (q <= self._description.lower) | (q >= self._description.upper)
        return IkSolution(
            q,
            position_error <= position_tolerance and orientation_error <= orientation_tolerance,
            position_error,
            orientation_error,
            tuple(name for name, hit in zip(self._description.joint_names, on_limit, strict=True) if hit),
        )


def _joint_transform(link: _Link, q: float) -> FloatArray:
    """Pose of a link in its parent at joint position `q` (Rodrigues' formula)."""
    T = np.eye(4)
    T[:3, 3] = link.offset
    x, y, z = link.axis
    if link.kind == "prismatic":
        T[:3, 3] += q * np.array(link.axis)
    else:
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        T[:3, :3] += np.sin(q) * K + (1 - np.cos(q)) * (K @ K)
    return T
