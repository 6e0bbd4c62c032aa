"""The hand that the weights `icub_hand` are of, the iCub's right one: a point of its palm, the sides it comes from."""

from __future__ import annotations

import numpy as np

from icub_core.geometry import FloatArray
from icub_grasp_generators.planned_hand import PlannedHand

PALM_POINT = np.array([0.033, -0.002, 0.001])
"""Point of the palm that faces the object's middle, in the hand frame, meters: what a voxel stands for."""

_FINGERS = np.array([[-0.036, 0.034], [-0.008, 0.034], [0.020, 0.034], [0.036, 0.034]])
"""Where index, middle, ring and little finger close: y and z in the hand frame, meters."""

YAW = (np.radians(150.0), np.radians(265.0))
"""Angles of the hand's x axis about the vertical that the right arm reaches on the table, rad."""


def is_learned(hand: PlannedHand) -> bool:
    """Return True if the weights were learned with such a hand, or with its mirror image."""
    return (
        hand.fingers.shape == _FINGERS.shape
        and np.allclose(hand.fingers, _FINGERS, atol=1e-3)
        and np.allclose(hand.palm, PALM_POINT, atol=1e-3)
    )


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
