"""Names, sizes and scales of the grasping task's actions and observations.

An action has 6 + F numbers in [-1, 1]: hand translation dx, dy, dz (world), hand rotation dyaw, dpitch, droll, and an
offset for each of the hand's F actuators. Scaled they are 2 mm, 0.01 rad and the actuators' own steps (for the iCub
0.2 rad, 0.4 rad for the tendon of ring and little finger).

The hand's orientation is written as R = Rx(roll) Ry(pitch) Rz(yaw). DIFF to the released code: yaw and roll lie in
[0, 2 pi) instead of (-pi, pi], because every palm-down grasp has both near pi, where the original jumps.
Source: thesis 12.3.1; scales as in the released experiments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import ConfigError, unknown_name
from icub_core.robot_description import HandDescription, RobotDescription

FloatArray = NDArray[np.float64]

TRANSLATION_STEP = 0.002
ROTATION_STEP = 0.01

FINGERTIPS_OF_A_GRASP = 2
"""Fingertips that must touch before an object counts as held (thesis 12.3.1)."""
HAND_POSE = "hand_pose"
FINGERS = "fingers"
TOUCH = "touch"
OBJECT_CENTER = "object_center"
VISUAL = "visual"
PLAN_START, PLAN_GRASP = "plan_start", "plan_grasp"
"""Positions of the hand at the pre-grasp and at the grasp that were planned, world, meters."""
PLAN_OPENED, PLAN_CLOSED = "plan_opened", "plan_closed"
"""Commands of the hand's actuators before and after closing, as planned."""
STEP = "step"
"""Control steps done in the episode: the clock of a scripted policy."""


@dataclass(frozen=True, eq=False)
class HandLayout:
    """Where one hand and the joints that carry it stand in the robot's vectors.

    Attributes:
        hand: Its description.
        reach_joints: (r,) indices of the joints that place the hand, in a joint vector.
        reach_actuators: (r,) indices of their actuators, in a command vector.
        fingers: (F,) indices of the hand's actuators, in a command vector.
        finger_step: (F,) what an action of 1 moves, rad.
        opened, closed: (F,) commands of the open and closed hand, rad.
        lower, upper: (m,) command limits, rad.
        max_speed, max_acceleration: (m,) limits of the command's motion, rad/s and rad/s^2.
    """

    hand: HandDescription
    reach_joints: NDArray[np.intp]
    reach_actuators: NDArray[np.intp]
    fingers: NDArray[np.intp]
    finger_step: FloatArray
    opened: FloatArray
    closed: FloatArray
    lower: FloatArray
    upper: FloatArray
    max_speed: FloatArray
    max_acceleration: FloatArray

    @property
    def action_scale(self) -> FloatArray:
        """(6 + F,) what an action of 1 means: meters, radians."""
        return np.concatenate([np.full(3, TRANSLATION_STEP), np.full(3, ROTATION_STEP), self.finger_step])

    def sizes(self) -> dict[str, int]:
        """Return the size of every observation but the visual one."""
        fingers, touch = len(self.fingers), len(self.hand.fingertips)
        sizes = {HAND_POSE: 6, FINGERS: fingers, TOUCH: touch, OBJECT_CENTER: 3}
        return {**sizes, PLAN_START: 3, PLAN_GRASP: 3, PLAN_OPENED: fingers, PLAN_CLOSED: fingers, STEP: 1}


def hand_layout(description: RobotDescription, name: str | None = None) -> HandLayout:
    """Look up a hand of a robot, the first by default.

    Raises:
        ConfigError: The robot has no such hand; a joint that carries it has no servo; an actuator of it has no step.
    """
    hand = description.hand(name)
    reach_names = description.groups.get(hand.reach)
    if reach_names is None:
        raise ConfigError(unknown_name(f"joint group of robot '{description.name}'", hand.reach, description.groups))
    servo_of = {next(iter(a.coefficients)): i for i, a in enumerate(description.actuators) if len(a.coefficients) == 1}
    missing = [joint for joint in reach_names if joint not in servo_of]
    if missing:
        raise ConfigError(f"joint '{missing[0]}' of group '{hand.reach}' has no actuator; the grasping task needs one")
    if not hand.actuators or len(hand.fingertips) < FINGERTIPS_OF_A_GRASP:
        raise ConfigError(
            f"the {hand.name} hand of '{description.name}' has {len(hand.actuators)} actuators and "
            f"{len(hand.fingertips)} fingertips; the grasping task needs at least 1 and {FINGERTIPS_OF_A_GRASP}"
        )
    fingers = description.actuator_indices(hand.actuators)
    actuators = [description.actuators[i] for i in fingers]
    still = [a.name for a in actuators if not a.step > 0]
    if still:
        raise ConfigError(f"actuator '{still[0]}' of robot '{description.name}' has step 0; a hand's needs one above 0")
    every = description.actuators
    return HandLayout(
        hand=hand,
        reach_joints=description.indices(hand.reach),
        reach_actuators=np.array([servo_of[joint] for joint in reach_names], dtype=np.intp),
        fingers=fingers,
        finger_step=np.array([a.step for a in actuators]),
        opened=np.array([a.open for a in actuators]),
        closed=np.array([a.close for a in actuators]),
        lower=np.array([a.range[0] for a in every]),
        upper=np.array([a.range[1] for a in every]),
        max_speed=np.array([a.max_speed for a in every]),
        max_acceleration=np.array([a.max_acceleration for a in every]),
    )


def euler_to_matrix(yaw_pitch_roll: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) of Rx(roll) Ry(pitch) Rz(yaw), angles (..., 3) ordered yaw, pitch, roll."""
    c, s = np.cos(yaw_pitch_roll), np.sin(yaw_pitch_roll)
    cy, cp, cr = c[..., 0], c[..., 1], c[..., 2]
    sy, sp, sr = s[..., 0], s[..., 1], s[..., 2]
    R = np.empty((*yaw_pitch_roll.shape[:-1], 3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 0, 2] = cp * cy, -cp * sy, sp
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = cr * sy + sr * sp * cy, cr * cy - sr * sp * sy, -sr * cp
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = sr * sy - cr * sp * cy, sr * cy + cr * sp * sy, cr * cp
    return R


def matrix_to_euler(R: FloatArray) -> FloatArray:
    """Invert `euler_to_matrix`: (..., 3) yaw in [0, 2 pi), pitch in [-pi/2, pi/2], roll in [0, 2 pi)."""
    angles = np.empty((*R.shape[:-2], 3))
    angles[..., 0] = np.arctan2(-R[..., 0, 1], R[..., 0, 0]) % (2 * np.pi)
    angles[..., 1] = np.arcsin(np.clip(R[..., 0, 2], -1.0, 1.0))
    angles[..., 2] = np.arctan2(-R[..., 1, 2], R[..., 2, 2]) % (2 * np.pi)
    return angles


def pose_vector(T_world_hand: FloatArray) -> FloatArray:
    """Return hand poses (..., 6) x, y, z, yaw, pitch, roll of transforms (..., 4, 4)."""
    return np.concatenate([T_world_hand[..., :3, 3], matrix_to_euler(T_world_hand[..., :3, :3])], axis=-1)
