"""Hand poses for what the networks find: a parallel jaw's grasp with the iCub's hand, or the hand's own palm point.

A gripper's frame has z along its approach and y along its opening. The iCub's hand opens between thumb (along its z)
and fingers (along its x): it takes objects in along (x + z) / sqrt 2 and closes along (x - z) / sqrt 2. So it is
turned by 45 degrees about the gripper's third axis, and as fingers and thumb may change sides there are two candidates.

Source: thesis 12.3.1 (VGN with the iCub). DIFF: its released code turns the grasp's position by 90 degrees about the
vertical to exchange the gripper's axes, which is right for grasps from above; here the gripper's own axes are
exchanged, which is right for all.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from icub_core.geometry import FloatArray, make_transform, rotation_about
from icub_grasp_generators.vgn.network import GRIPPER
from icub_grasp_generators.vgn.palm import from_palm
from icub_grasp_generators.vgn.selection import Selected
from icub_grasp_generators.vgn.volume import Volume

TILT = np.pi / 4
_SIDES = (np.pi / 2, -np.pi / 2)
_GRIPPER_TO_HAND = [rotation_about("z", side) @ rotation_about("y", -TILT) for side in _SIDES]


def hand_poses(found: Selected, volume: Volume, pose: str) -> tuple[FloatArray, FloatArray]:
    """Return poses (C, 4, 4) of the right hand frame, world, and their qualities (C,), best first.

    Args:
        found: Voxels.
        volume: Their cube.
        pose: What a voxel's rotation belongs to; a ``"gripper"`` gives two candidates a voxel.
    """
    points = volume.point_of(found.index)
    rotations = Rotation.from_quat(found.quaternion).as_matrix() if len(points) else np.zeros((0, 3, 3))
    poses = [make_transform(R, p) for R, p in zip(rotations, points, strict=True)]
    if pose != GRIPPER:
        return from_palm(np.array(poses).reshape(-1, 4, 4)), found.quality
    both = [T @ make_transform(turn) for T in poses for turn in _GRIPPER_TO_HAND]
    return np.array(both).reshape(-1, 4, 4), np.repeat(found.quality, 2)
