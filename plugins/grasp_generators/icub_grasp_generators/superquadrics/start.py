"""From a cloud to starts of the fit: oriented boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import FloatArray, rotation_about
from icub_grasp_generators.clouds import check_cloud, covariance, thin, trimmed_extents
from icub_grasp_generators.superquadrics.residuals import Solids
from icub_support.rotations import spread_rotations

FIT_POINTS = 500
_TRIM = 0.06  # share cut off at both ends of an extent: outliers must not span the box
_START_EXPONENTS = (0.4, 0.5)
_AXIS_ORDERS = ([0, 1, 2], [1, 2, 0], [2, 0, 1])  # each axis in turn as the axis of revolution
_SHOULDER = 0.8  # share of the points below the shoulder that a cap stands on
_YAWS = 12
_FREE = 96


def usable_sample(points: NDArray[np.floating]) -> FloatArray:
    """Return at most 500 of the points (N, 3), always the same ones; raises DataError as `check_cloud` does."""
    check_cloud(points)
    return thin(points, FIT_POINTS)


def _extents(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return trimmed low and high (...) of coordinates (..., N)."""
    return trimmed_extents(rows, _TRIM)


def scale_of(points: FloatArray) -> tuple[FloatArray, float]:
    """Return the middle (3,) and half the diagonal of the trimmed box around points (N, 3)."""
    low, high = _extents(points.T)
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2


def starts(points: FloatArray, table: float | None) -> Solids:
    """Return six solids in boxes around points (N, 3): two boxes, each with every axis as the axis of revolution.

    In the air the boxes are the two smallest. On a table they are upright and reach down to it: the smallest, and the
    same without what stands on its top (the cap of a bottle).

    Args:
        points: In the frame of the fit, about one unit across.
        table: Height of the table in that frame.
    """
    Rs = _UPRIGHT if table is not None else _principal(points) @ _SPREAD
    low, high = _extents(Rs.transpose(0, 2, 1) @ points.T)
    best = np.argsort(np.prod((high - low)[:, :2] if table is not None else high - low, axis=1), kind="stable")[:2]
    if table is not None:
        best[1] = best[0]
    Rs, low, high = Rs[best], low[best], high[best]
    if table is not None:
        shoulder = int(_SHOULDER * len(points))
        high[1, 2] = np.partition(points[:, 2], shoulder)[shoulder]
        low[:, 2] = np.minimum(table, high[:, 2] - 0.02)
    center = (Rs @ ((low + high) / 2)[..., None])[..., 0]
    half = np.maximum((high - low) / 2, 0.02)
    vector = np.zeros((2, 3, 8))
    vector[:, :, :3] = center[:, None]
    vector[:, :, 3:6] = np.log(half[:, _AXIS_ORDERS])
    vector[:, :, 6:] = _START_EXPONENTS
    turned = np.stack([Rs[:, :, order] for order in _AXIS_ORDERS], axis=1)
    return Solids(turned.reshape(6, 3, 3), vector.reshape(6, 8))


def _principal(points: FloatArray) -> FloatArray:
    """Principal axes (3, 3) of the points, right-handed."""
    _, axes = np.linalg.eigh(covariance(points))
    return axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])


_SPREAD = spread_rotations(_FREE)
_UPRIGHT = np.stack([rotation_about("z", k * np.pi / 2 / _YAWS) for k in range(_YAWS)])
