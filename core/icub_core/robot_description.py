"""A robot as data: what every loader (MuJoCo, PyBullet, Pinocchio, Placo) needs beside the one URDF file."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import ConfigError, unknown_name
from icub_core.scene import QuatWxyz, Vec3

HANDS_SINCE = "0.2"
"""Version of the interfaces in which `RobotDescription.hands` came."""

_Entry = TypeVar("_Entry")


@dataclass(frozen=True)
class Actuator:
    """A position servo on one joint or on a weighted sum of joints (an under-actuated tendon).

    Its length is sum(coefficients[j] * q[j]) + offset; the command is a length too. Lengths are radians where the
    joints turn and meters where they slide.

    Attributes:
        name: Unique.
        coefficients: Joint name to weight.
        kp: Proportional gain, Nm/rad or N/m; damping belongs to the joints.
        range: Lowest and highest command.
        offset: Added to the weighted sum.
        open, close: Commands of the open and the closed hand; equal for arm joints, where they mean nothing.
        step: What one control step may at most change the command by, for an actuator of a hand; 0 for an arm's.
        max_speed: Command change per second that the robot permits.
        max_acceleration: Change of that speed per second.
    """

    name: str
    coefficients: Mapping[str, float]
    kp: float
    range: tuple[float, float]
    offset: float = 0.0
    open: float = 0.0
    close: float = 0.0
    step: float = 0.0
    max_speed: float = 3.0
    max_acceleration: float = 120.0


@dataclass(frozen=True, eq=False)
class Grip:
    """Where a hand holds an object, as a planner needs it.

    The grip frame has its origin on the palm's surface, between the opposed fingers: x is the axis along which the
    hand closes, z the approach axis (out of the palm, towards the object), y completes the right-handed frame. Where
    the two sides of the closing differ, the thumb is at negative x and the fingers are at positive x.

    Attributes:
        T_hand_grip: (4, 4) pose of the grip frame in the hand's frame.
        width: Widest object that fits between the fingers, meters.
        fingers_y: (k,) positions along y at which the fingers close, meters.
        depth: Height above the palm, along z, at which they close, meters.
        sweep: (3, 2) lowest and highest x, y, z that the closing fingers pass through, grip frame, meters.
        half_axes: Of the ellipsoid that the inside of the closing hand resembles, along x, y and z, meters.
        yaws: Lowest and highest angle of the x axis about the vertical at which the arm brings the hand to a table in
            front of the robot, world, rad; the whole circle permits all.
        mirrored: The hand is the left one of a pair. Planners that draw the poses of a right hand plan for its image
            in the robot's plane of symmetry (y = 0); `yaws` are those of the image.
        T_hand_jaw: (4, 4) pose, in the hand's frame, of the parallel jaw that the hand can stand in for: x along its
            opening, z along its approach. None where this is the grip frame.
    """

    T_hand_grip: NDArray[np.float64]
    width: float
    fingers_y: NDArray[np.float64]
    depth: float
    sweep: NDArray[np.float64]
    half_axes: Vec3 = (0.03, 0.03, 0.03)
    yaws: tuple[float, float] = (0.0, 2 * np.pi)
    mirrored: bool = False
    T_hand_jaw: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class HandDescription:
    """One hand and what carries it.

    Attributes:
        name: Such as ``"right"``.
        frame: Link that grasp poses are stated for.
        reach: Joint group that places `frame`.
        actuators: Names of the hand's actuators, in the order of observations and actions.
        fingertips: Links that report touch, in the order of observations.
        grip: Where the hand holds an object; None for a hand that planners cannot use.
        workspace: (2, 3) lowest and highest world position at which `frame` may be commanded, meters; None permits all.
    """

    name: str
    frame: str
    reach: str
    actuators: tuple[str, ...]
    fingertips: tuple[str, ...]
    grip: Grip | None = None
    workspace: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class JointDynamics:
    """Passive behavior of one joint, SI units."""

    damping: float = 5.0
    stiffness: float = 0.01
    frictionloss: float = 0.01


@dataclass(frozen=True)
class CoupledJoint:
    """A joint that a mechanism moves with another: q[joint] = multiplier * q[leader], rad.

    Loaders add it as an equality constraint. None of these exist where the coupling is under-actuated (a tendon).
    """

    joint: str
    leader: str
    multiplier: float


@dataclass(frozen=True)
class ContactMaterial:
    """Contact parameters of a link's geoms, in MuJoCo's terms; other engines use what they can."""

    friction: Vec3 = (1.0, 0.005, 0.0001)
    condim: int = 3
    priority: int = 0
    solref: tuple[float, float] | None = None
    solimp: Vec3 | None = None


@dataclass(frozen=True)
class RobotCamera:
    """A camera fixed to a link: T_link_camera as position and quaternion, z forward and y down; `fovy` in radians."""

    name: str
    link: str
    position: Vec3
    quat_wxyz: QuatWxyz
    fovy: float
    width: int = 640
    height: int = 480


class _OldTable(dict[str, _Entry]):
    """A table by hand that tells a plugin of version 0.1, which assumes the names of the iCub's hands, what changed."""

    def __missing__(self, name: str) -> _Entry:
        raise ConfigError(
            f"the robot has no hand '{name}'; since version {HANDS_SINCE} of the interfaces the name of a hand is any "
            f"string (here: {', '.join(self)}), and None is the robot's first: description.hand(None)"
        )


def _old(name: str, attribute: str, table: dict[str, _Entry]) -> Mapping[str, _Entry]:
    text = f"RobotDescription.{name} goes with the next release; use description.hand(name).{attribute}"
    warnings.warn(text, DeprecationWarning, stacklevel=3)
    return _OldTable(table)


@dataclass(frozen=True, eq=False)
class RobotDescription:
    """Everything about a robot that is data.

    Attributes:
        name: Registry name.
        urdf: One file with absolute mesh paths, that all loaders read.
        T_world_root: (4, 4) where the root link is fixed.
        joint_names: Movable joints in the order of every joint vector.
        lower, upper: (n,) limits, rad.
        groups: Joint names by group, such as ``right_arm``, ``torso``, ``right_hand``.
        actuators: In the order of every command vector.
        home: Joint positions at rest, rad; unlisted joints are 0.
        hands: By name; the first is the one that is used where none is named.
        dynamics, contacts: By joint, by link; absent names take the defaults.
        contact_excludes: Pairs of links that never collide.
        capsule_links: Links whose every ``<cylinder>`` in the URDF stands for a capsule of that radius, with its end
            spheres centered on the cylinder's end faces (the length is the segment between them). The file says
            cylinder because the parser of Pinocchio and Placo refuses capsules; engines that know them turn them back.
        coupled_joints: Joints that follow others rigidly.
        gravity_compensation: Whether the robot carries its own weight without effort.
    """

    name: str
    urdf: Path
    T_world_root: NDArray[np.float64]
    joint_names: tuple[str, ...]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    groups: Mapping[str, tuple[str, ...]]
    actuators: tuple[Actuator, ...]
    home: Mapping[str, float]
    hands: Mapping[str, HandDescription] = field(default_factory=dict)
    cameras: tuple[RobotCamera, ...] = ()
    dynamics: Mapping[str, JointDynamics] = field(default_factory=dict)
    contacts: Mapping[str, ContactMaterial] = field(default_factory=dict)
    contact_excludes: tuple[tuple[str, str], ...] = ()
    capsule_links: frozenset[str] = frozenset()
    coupled_joints: tuple[CoupledJoint, ...] = ()
    gravity_compensation: bool = True

    @property
    def home_q(self) -> NDArray[np.float64]:
        """Home pose as a joint vector (n,), rad."""
        return np.array([self.home.get(name, 0.0) for name in self.joint_names])

    def hand(self, name: str | None = None) -> HandDescription:
        """Return a hand by name, or the first; ConfigError names the nearest, or says that the robot has none."""
        if not self.hands:
            raise ConfigError(f"robot '{self.name}' has no hand")
        if name is None:
            return next(iter(self.hands.values()))
        if name not in self.hands:
            raise ConfigError(unknown_name(f"hand of robot '{self.name}'", name, self.hands))
        return self.hands[name]

    @property
    def hand_frames(self) -> Mapping[str, str]:
        """Frame of each hand; deprecated, use ``hand(name).frame``."""
        return _old("hand_frames", "frame", {name: hand.frame for name, hand in self.hands.items()})

    @property
    def hand_actuators(self) -> Mapping[str, tuple[str, ...]]:
        """Actuators of each hand; deprecated, use ``hand(name).actuators``."""
        return _old("hand_actuators", "actuators", {name: hand.actuators for name, hand in self.hands.items()})

    @property
    def fingertips(self) -> Mapping[str, tuple[str, ...]]:
        """Fingertips of each hand; deprecated, use ``hand(name).fingertips``."""
        return _old("fingertips", "fingertips", {name: hand.fingertips for name, hand in self.hands.items()})

    def reach_group(self, frame: str) -> str:
        """Return the joint group that places a hand's frame; ConfigError for a frame that belongs to no hand."""
        for hand in self.hands.values():
            if hand.frame == frame:
                return hand.reach
        raise ConfigError(f"'{frame}' is no hand's frame of robot '{self.name}'; name the joint group to move")

    def camera(self, name: str | None = None) -> RobotCamera:
        """Return a camera by name, or the first; ConfigError names the nearest, or says that the robot has none."""
        known = {camera.name: camera for camera in self.cameras}
        if not known:
            raise ConfigError(f"robot '{self.name}' has no camera")
        if name is None:
            return self.cameras[0]
        if name not in known:
            raise ConfigError(unknown_name(f"camera of robot '{self.name}'", name, known))
        return known[name]

    def indices(self, group: str) -> NDArray[np.intp]:
        """Return where the joints of `group` stand in a joint vector; ConfigError names the nearest group."""
        if group not in self.groups:
            raise ConfigError(unknown_name(f"joint group of robot '{self.name}'", group, self.groups))
        position = {name: i for i, name in enumerate(self.joint_names)}
        return np.array([position[name] for name in self.groups[group]], dtype=np.intp)

    def actuator_indices(self, names: tuple[str, ...]) -> NDArray[np.intp]:
        """Return where the named actuators stand in a command vector; ConfigError names the nearest actuator."""
        position = {a.name: i for i, a in enumerate(self.actuators)}
        for name in names:
            if name not in position:
                raise ConfigError(unknown_name(f"actuator of robot '{self.name}'", name, position))
        return np.array([position[name] for name in names], dtype=np.intp)

    def actuator_matrix(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (A, b) such that actuator lengths are A q + b; A is (m, n)."""
        position = {name: i for i, name in enumerate(self.joint_names)}
        A = np.zeros((len(self.actuators), len(self.joint_names)))
        for row, actuator in enumerate(self.actuators):
            for joint, coefficient in actuator.coefficients.items():
                A[row, position[joint]] = coefficient
        return A, np.array([a.offset for a in self.actuators])
