"""The iCub's right hand as the network sees it: a point of the palm, and the sides that it comes from."""

from __future__ import annotations

import numpy as np

from icub_core.geometry import FloatArray

PALM_POINT = np.array([0.033, -0.002, 0.001])
"""Point of the palm that faces the object's middle, in the hand frame, meters: what a voxel stands for."""

YAW = (np.radians(150.0), np.radians(265.0))
"""Angles of the hand's x axis about the vertical that the right arm reaches on the table, rad."""


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
