"""Hand poses around a surface: drawn broadly, and moved so that the surface lies where fingers and palm can hold it.

Trials explore with them, and the generator draws them around the voxels that its network prefers.
"""

from __future__ import annotations

import numpy as np

from icub_core.geometry import FloatArray
from icub_grasp_generators.vgn.palm import PALM_POINT, YAW

ROLL = (np.radians(-45.0), np.radians(95.0))
DIP = (np.radians(-45.0), 0.0)
_OFFSET_LOW, _OFFSET_HIGH = np.array([-0.018, -0.035, 0.0]), np.array([0.012, 0.035, 0.012])
"""Meters from the palm point to the drawn surface point, in the hand frame."""
_GRIP_LOW, _GRIP_HIGH = np.array([-0.02, -0.045, 0.004]), np.array([0.065, 0.05, 0.06])
"""Box in the hand frame that the closing fingers sweep."""
MIN_GRIPPED = 0.08
"""Share of the object's surface points in that box below which nothing would be held."""

_BETWEEN_LOW, _BETWEEN_HIGH = np.array([-0.03, -0.035, -0.02]), np.array([0.10, 0.035, 0.07])
"""Box around the fingers in which the surface is put in the middle between thumb and fingers."""
_BEFORE_LOW, _BEFORE_HIGH = np.array([-0.05, -0.03, -0.08]), np.array([0.07, 0.03, 0.12])
"""Box around the palm in which the nearest of the surface is put before the palm."""
_MIDDLE = (0.024, 0.040)
"""Place of that middle along the fingers, meters in the hand frame."""
_GAP = (0.0, 0.010)
"""Meters between palm and surface."""


def draw_poses(surface: FloatArray, rng: np.random.Generator, count: int) -> FloatArray:
    """Draw hand poses (count, 4, 4) whose palm points are near points of the surface (N, 3).

    x stays horizontal at an angle that the right arm reaches, a roll about it takes the palm from looking down to
    looking sideways, and the fingers dip by up to 45 degrees, half of them not at all.
    """
    poses = np.tile(np.eye(4), (count, 1, 1))
    yaw, roll, dip = rng.uniform(*YAW, count), rng.uniform(*ROLL, count), rng.uniform(*DIP, count)
    dip[rng.random(count) < 0.5] = 0.0
    flat = _about(2, yaw) @ np.diag([1.0, -1.0, -1.0])
    poses[:, :3, :3] = flat @ _about(0, roll) @ _about(1, dip)
    touched = PALM_POINT + rng.uniform(_OFFSET_LOW, _OFFSET_HIGH, (count, 3))
    points = surface[rng.integers(len(surface), size=count)]
    poses[:, :3, 3] = points - np.einsum("nij,nj->ni", poses[:, :3, :3], touched)
    return poses


def fitted(T: FloatArray, surface: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Move poses (C, 4, 4) along their x and z so that the surface (N, 3) lies between the fingers, before the palm."""
    T = np.array(T)
    for low, high, axis in ((_BETWEEN_LOW, _BETWEEN_HIGH, 0), (_BEFORE_LOW, _BEFORE_HIGH, 2)):
        local = (surface - T[:, None, :3, 3]) @ T[:, :3, :3]
        inside = np.all((local > low) & (local < high), axis=2)
        some = inside.any(axis=1)
        along = local[some, :, axis]
        nearest = np.where(inside[some], along, np.inf).min(axis=1)
        move = np.zeros(len(T))
        if axis == 0:
            furthest = np.where(inside[some], along, -np.inf).max(axis=1)
            move[some] = (nearest + furthest) / 2 - rng.uniform(*_MIDDLE, len(nearest))
        else:
            move[some] = nearest - rng.uniform(*_GAP, len(nearest))
        T[:, :3, 3] += move[:, None] * T[:, :3, axis]
    return T


def gripped_share(T: FloatArray, surface: FloatArray) -> FloatArray:
    """Return the share (C,) of surface points (N, 3) that the closing fingers of hands at T (C, 4, 4) sweep."""
    local = (surface - T[:, None, :3, 3]) @ T[:, :3, :3]
    return np.asarray(np.all((local > _GRIP_LOW) & (local < _GRIP_HIGH), axis=2).mean(axis=1))


def _about(axis: int, angles: FloatArray) -> FloatArray:
    """Return rotations (N, 3, 3) about a coordinate axis by `angles` (N,), rad."""
    R = np.zeros((len(angles), 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[:, axis, axis] = 1.0
    R[:, i, i] = R[:, j, j] = np.cos(angles)
    R[:, j, i] = np.sin(angles)
    R[:, i, j] = -R[:, j, i]
    return R
