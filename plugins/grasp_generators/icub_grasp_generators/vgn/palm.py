"""The point of the iCub's palm that stands for its pose in a voxel."""

from __future__ import annotations

import numpy as np

from icub_core.geometry import FloatArray

PALM_POINT = np.array([0.033, -0.002, 0.001])
"""Point of the palm that faces the object's middle, in the hand frame, metres: what a voxel stands for."""


def at_palm(T_world_hand: FloatArray) -> FloatArray:
    """Return poses (G, 4, 4) of the palm point, axes as the hand's."""
    T = np.array(T_world_hand)
    T[:, :3, 3] += T[:, :3, :3] @ PALM_POINT
    return T


def from_palm(T_world_palm: FloatArray) -> FloatArray:
    """Invert `at_palm`."""
    T = np.array(T_world_palm)
    T[:, :3, 3] -= T[:, :3, :3] @ PALM_POINT
    return T
