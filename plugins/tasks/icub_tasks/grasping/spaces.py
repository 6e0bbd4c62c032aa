"""Names, sizes and scales of the grasping task's actions and observations.

An action has 15 numbers in [-1, 1]: hand translation dx, dy, dz (world), hand rotation dyaw, dpitch, droll, and nine
finger offsets. Scaled they are 2 mm, 0.01 rad and 0.2 rad (0.4 rad for the pinky tendon) a step.

The hand's orientation is written as R = Rx(roll) Ry(pitch) Rz(yaw). DIFF to the released code: yaw and roll lie in
[0, 2 pi) instead of (-pi, pi], because every palm-down grasp has both near pi, where the original jumps.
Source: thesis 12.3.1; scales as in the released experiments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import ConfigError, unknown_name
from icub_core.robot_description import RobotDescription

FloatArray = NDArray[np.float64]

TRANSLATION_STEP = 0.002
ROTATION_STEP = 0.01
FINGER_STEP = 0.2
PINKY_STEP = 0.4

NUMBER_OF_FINGER_ACTUATORS = 9
ACTION_SIZE = 6 + NUMBER_OF_FINGER_ACTUATORS

HAND_POSE = "hand_pose"
FINGERS = "fingers"
TOUCH = "touch"
OBJECT_CENTER = "object_center"
VISUAL = "visual"
PLAN = "plan"
OBSERVATION_SIZES = {HAND_POSE: 6, FINGERS: 9, TOUCH: 5, OBJECT_CENTER: 3}
PLAN_START, PLAN_GRASP, PLAN_STEP = slice(0, 3), slice(3, 6), 6
PLAN_OPENED, PLAN_CLOSED, PLAN_FINGER_STEP = slice(7, 16), slice(16, 25), slice(25, 34)
PLAN_SIZE = 34
"""Privileged entry for scripted policies only: positions of the pre-grasp and of the grasp (world, meters), control
steps done, and of the nine finger actuators the opened and closed command and what an action of 1 moves (rad)."""


@dataclass(frozen=True, eq=False)
class HandLayout:
    """Where one hand and the joints that carry it stand in the robot's vectors.

    Attributes:
        frame: Frame that grasps are stated in.
        side: ``"right"`` or ``"left"``.
        reach_joints: (r,) indices of the joints that place the hand, in a joint vector.
        reach_actuators: (r,) indices of their actuators, in a command vector.
        fingers: (9,) indices of the finger actuators, in a command vector.
        finger_step: (9,) rad moved by an action of 1.
        opened, closed: (9,) commands of the open and closed hand, rad.
        lower, upper: (m,) command limits, rad.
    """

    frame: str
    side: str
    reach_joints: NDArray[np.intp]
    reach_actuators: NDArray[np.intp]
    fingers: NDArray[np.intp]
    finger_step: FloatArray
    opened: FloatArray
    closed: FloatArray
    lower: FloatArray
    upper: FloatArray

    @property
    def action_scale(self) -> FloatArray:
        """(15,) what an action of 1 means: meters, radians."""
        return np.concatenate([np.full(3, TRANSLATION_STEP), np.full(3, ROTATION_STEP), self.finger_step])


def hand_layout(description: RobotDescription, side: str = "right") -> HandLayout:
    """Look up a hand of a robot; ConfigError when the robot lacks nine finger actuators or a servo per reach joint."""
    if side not in description.hand_frames:
        raise ConfigError(unknown_name(f"hand of robot '{description.name}'", side, description.hand_frames))
    reach_names = description.groups[f"{side}_reach"]
    servo_of = {next(iter(a.coefficients)): i for i, a in enumerate(description.actuators) if len(a.coefficients) == 1}
    missing = [name for name in reach_names if name not in servo_of]
    if missing:
        raise ConfigError(f"joint '{missing[0]}' of group '{side}_reach' has no actuator; the grasping task needs one")
    names = description.hand_actuators.get(side, ())
    if len(names) != NUMBER_OF_FINGER_ACTUATORS:
        raise ConfigError(f"the {side} hand of '{description.name}' has {len(names)} actuators; expected 9")
    fingers = description.actuator_indices(names)
    actuators = [description.actuators[i] for i in fingers]
    return HandLayout(
        frame=description.hand_frames[side],
        side=side,
        reach_joints=description.indices(f"{side}_reach"),
        reach_actuators=np.array([servo_of[name] for name in reach_names], dtype=np.intp),
        fingers=fingers,
        finger_step=np.array([PINKY_STEP if "pinky" in a.name else FINGER_STEP for a in actuators]),
        opened=np.array([a.open for a in actuators]),
        closed=np.array([a.close for a in actuators]),
        lower=np.array([a.range[0] for a in description.actuators]),
        upper=np.array([a.range[1] for a in description.actuators]),
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
