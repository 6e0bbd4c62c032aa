"""Hand poses for what the networks find: a parallel jaw's grasp with another hand, or the iCub's own palm point.

A gripper's frame has z along its approach and y along its opening. The hand's description says where such a jaw would
be (`Grip.T_hand_jaw`, with x along the opening), and as the two sides of the jaw may change places there are two
candidates. The iCub's hand opens between thumb (along its z) and fingers (along its x): it takes objects in along
(x + z) / sqrt 2 and closes along (x - z) / sqrt 2, so its jaw is turned by 45 degrees.

Source: thesis 12.3.1 (VGN with the iCub). DIFF: its released code turns the grasp's position by 90 degrees about the
vertical to exchange the gripper's axes, which is right for grasps from above; here the gripper's own axes are
exchanged, which is right for all.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from icub_core.geometry import FloatArray, invert, make_transform, rotation_about
from icub_grasp_generators.planned_hand import PlannedHand
from icub_grasp_generators.vgn.network import GRIPPER
from icub_grasp_generators.vgn.palm import from_palm
from icub_grasp_generators.vgn.selection import Selected
from icub_grasp_generators.vgn.volume import Volume

_SIDES = (np.pi / 2, -np.pi / 2)


def hand_poses(found: Selected, volume: Volume, pose: str, hand: PlannedHand) -> tuple[FloatArray, FloatArray]:
    """Return poses (C, 4, 4) of the hand's planning frame, world, and their qualities (C,), best first.

    Args:
        found: Voxels.
        volume: Their cube.
        pose: What a voxel's rotation belongs to; a ``"gripper"`` gives two candidates a voxel.
        hand: What grasps; for a pose of another kind, one that the weights were learned with.
    """
    points = volume.point_of(found.index)
    rotations = Rotation.from_quat(found.quaternion).as_matrix() if len(points) else np.zeros((0, 3, 3))
    poses = [make_transform(R, p) for R, p in zip(rotations, points, strict=True)]
    if pose != GRIPPER:
        return from_palm(np.array(poses).reshape(-1, 4, 4)), found.quality
    turns = [make_transform(rotation_about("z", side)) @ invert(hand.T_jaw) for side in _SIDES]
    both = [T @ turn for T in poses for turn in turns]
    return np.array(both).reshape(-1, 4, 4), np.repeat(found.quality, 2)
