"""Facts of the iCub's body: joint groups, limits, gains, home pose, cameras. Data only, SI units.

Sources: joint limits "urdf" from iCubGazeboV2_7 of icub-models; limits "ikin", gains, damping, home pose, cameras and
contact exclusions from the simulated iCub of hsp-iit/rl-icub-dexterous-manipulation (BSD-3-Clause).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from icub_core.geometry import matrix_to_quat_wxyz, quat_wxyz_to_matrix, rotation_about
from icub_core.robot_description import JointDynamics, RobotCamera
from icub_core.scene import QuatWxyz, Vec3

TORSO = ("torso_pitch", "torso_roll", "torso_yaw")
NECK = ("neck_pitch", "neck_roll", "neck_yaw")
_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_prosup", "wrist_pitch", "wrist_yaw")
_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
ROOT_POSITION = (0.0, 0.0, 1.0)  # of root_link in the world, unrotated

_IKIN_ARM = {
    "shoulder_pitch": (-1.66679, 0.08727),
    "shoulder_roll": (0.0, 2.80649),
    "shoulder_yaw": (-0.64577, 1.74533),
    "elbow": (0.09599, 1.85005),
    "wrist_prosup": (-0.87266, 0.87266),
    "wrist_pitch": (-1.13446, 0.17453),
    "wrist_yaw": (-0.43633, 0.43633),
}
_IKIN_TORSO = {"torso_pitch": (-0.38397, 1.46608), "torso_roll": (-0.68068, 0.68068), "torso_yaw": (-1.02974, 1.02974)}

LimitSet = Literal["ikin", "urdf"]
LIMIT_SETS: dict[LimitSet, dict[str, tuple[float, float]]] = {
    "ikin": {**_IKIN_TORSO, **{f"{side}_{joint}": r for side in "rl" for joint, r in _IKIN_ARM.items()}},
    "urdf": {},
}
"""By name, what replaces the limits of the URDF; joints that are not named keep those of the URDF."""

_ARM_KP = dict(zip(_ARM, (800.0, 200.0, 200.0, 200.0, 195.0, 100.0, 105.0), strict=True))
_ARM_DAMPING = dict(zip(_ARM, (2.5, 5.0, 2.5, 5.0, 1.0, 1.0, 1.0), strict=True))
KP = {
    **dict(zip(TORSO, (470.0, 990.0, 975.0), strict=True)),
    **dict(zip(NECK, (195.0, 460.0, 195.0), strict=True)),
    **{f"{side}_{joint}": kp for side in "rl" for joint, kp in _ARM_KP.items()},
}
DYNAMICS = {
    "torso_pitch": JointDynamics(damping=27.5),
    "torso_roll": JointDynamics(damping=42.5),
    "torso_yaw": JointDynamics(damping=27.5),
    "neck_yaw": JointDynamics(damping=2.5),
    **{f"{side}_{joint}": JointDynamics(damping=d) for side in "rl" for joint, d in _ARM_DAMPING.items()},
}

HOME = {
    "neck_pitch": -0.50,
    "r_shoulder_pitch": -0.159,
    "r_shoulder_roll": 1.3,
    "r_shoulder_yaw": 0.183,
    "r_elbow": 1.7,
    "r_wrist_prosup": -0.5,
    "l_shoulder_pitch": -0.159,
    "l_shoulder_roll": 2.0,
    "l_shoulder_yaw": 0.183,
    "l_elbow": 0.54,
}

FOREARM_RADIUS = 0.032
FOREARM_SEGMENT = (0.003, 0.082)  # along the axis of the wrist's pronation, meters from the forearm's origin


def arm(side: str) -> tuple[str, ...]:
    """Return the seven joints of the ``"right"`` or ``"left"`` arm, shoulder to wrist."""
    return tuple(f"{side[0]}_{joint}" for joint in _ARM)


def leg(side: str) -> tuple[str, ...]:
    """Return the six joints of the ``"right"`` or ``"left"`` leg, hip to ankle."""
    return tuple(f"{side[0]}_{joint}" for joint in _LEG)


def _camera(name: str, link: str, position: Vec3, mujoco_quat_wxyz: QuatWxyz, fovy_deg: float) -> RobotCamera:
    # MuJoCo's cameras look along -z with y up: half a turn about x makes z forward and y down
    R = quat_wxyz_to_matrix(mujoco_quat_wxyz) @ rotation_about("x", np.pi)
    w, x, y, z = matrix_to_quat_wxyz(R).tolist()
    return RobotCamera(name, link, position, (w, x, y, z), math.radians(fovy_deg), width=640, height=480)


CAMERAS = (
    _camera(
        "head_cam",  # field of view of the RealSense D415's color camera
        "head",
        (0.043454, 0.217822, 0.0835957),
        (-0.0233008, 0.0078341, 0.9825643, 0.1842908),
        42.4608673,
    ),
    _camera(
        "front_cam",
        "root_link",
        (-0.75 - ROOT_POSITION[0], 0.0 - ROOT_POSITION[1], 1.15 - ROOT_POSITION[2]),
        (-0.5, -0.5, 0.5, 0.5),
        70.0,
    ),
)
