"""A robot as data: what every loader (MuJoCo, PyBullet, Pinocchio, Placo) needs beside the one URDF file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import ConfigError, unknown_name
from icub_core.scene import QuatWxyz, Vec3


@dataclass(frozen=True)
class Actuator:
    """A position servo on one joint or on a weighted sum of joints (an under-actuated tendon).

    Its length is sum(coefficients[j] * q[j]) + offset; the command is a length too.

    Attributes:
        name: Unique.
        coefficients: Joint name to weight.
        kp: Proportional gain, Nm/rad; damping belongs to the joints.
        range: Lowest and highest command, rad.
        offset: Added to the weighted sum, rad.
        open, close: Commands of the open and the closed hand; equal for arm joints, where they mean nothing.
    """

    name: str
    coefficients: Mapping[str, float]
    kp: float
    range: tuple[float, float]
    offset: float = 0.0
    open: float = 0.0
    close: float = 0.0


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
        actuators: In the order of every command vector: torso, neck, arms, each arm followed by its hand's nine, so the
            last nine are those of the (only, or the right) hand.
        home: Joint positions at rest, rad; unlisted joints are 0.
        fingertips: Links by hand (``"right"``, ``"left"``): thumb, index, middle, ring, little.
        hand_frames: Frame of each hand that grasps are stated in.
        hand_actuators: Actuator names by hand, in the order of observations and actions: hand_finger, thumb_oppose,
            thumb_proximal, thumb_distal, index_proximal, index_distal, middle_proximal, middle_distal, pinky.
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
    fingertips: Mapping[str, tuple[str, ...]]
    hand_frames: Mapping[str, str]
    hand_actuators: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
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
