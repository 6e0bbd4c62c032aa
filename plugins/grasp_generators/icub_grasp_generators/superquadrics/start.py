"""From a raw cloud to starts of the fit: checks, thinning, isolated points, oriented boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from icub_core.errors import DataError
from icub_core.geometry import FloatArray, quat_wxyz_to_matrix, rotation_about
from numpy.typing import NDArray
from scipy.spatial import cKDTree

MIN_POINTS = 20
MAX_EXTENT = 1.0
"""Metres. A larger cloud is a wall or a wrong unit, not something to take into a hand."""
MIN_EXTENT = 1e-3

_FIT_POINTS = 500
_NEIGHBOUR = 4
_ISOLATED = 3.0  # times the median distance to the 4th neighbour
_TRIM = 0.01  # share cut off at both ends of an extent: isolated points were removed, some outliers remain
_YAWS = 18


@dataclass(frozen=True, eq=False)
class Start:
    """A box around the cloud: rotation (3, 3) whose columns are the axes, centre (3,), half extents (3,)."""

    R: FloatArray
    center: FloatArray
    half: FloatArray


def check_cloud(points: NDArray[np.floating]) -> None:
    """Raise DataError, one line, unless `points` (N, 3) is a finite surface of the size of a graspable object."""
    if len(points) < MIN_POINTS:
        raise DataError(f"the cloud has {len(points)} points; a superquadric needs at least {MIN_POINTS}")
    if not np.all(np.isfinite(points)):
        bad = int(np.sum(~np.all(np.isfinite(points), axis=1)))
        raise DataError(f"{bad} of the cloud's {len(points)} points are not finite; drop them before planning")
    low, high = np.quantile(points, [0.1, 0.9], axis=0)
    if float(np.max(high - low)) > MAX_EXTENT:
        extent = float(np.max(high - low))
        raise DataError(
            f"the cloud extends over {extent:.3g} m; expected one object of at most {MAX_EXTENT} m, in metres"
        )
    spread = np.linalg.svd(points - np.median(points, axis=0), compute_uv=False) / np.sqrt(len(points))
    if spread[0] < MIN_EXTENT:
        raise DataError(f"all points of the cloud lie within {spread[0] * 1e3:.2g} mm; expected a surface")
    if spread[1] < 0.02 * spread[0]:
        raise DataError("the points of the cloud lie on one line; expected a surface")


def thin(points: NDArray[np.floating], count: int = _FIT_POINTS) -> FloatArray:
    """Return at most `count` of the points, always the same ones."""
    if len(points) <= count:
        return np.array(points, dtype=np.float64)
    chosen = np.random.default_rng(0).choice(len(points), size=count, replace=False)
    return np.array(points[np.sort(chosen)], dtype=np.float64)


def isolated(points: FloatArray) -> NDArray[np.bool_]:
    """Say which of the points (N, 3) are far from their neighbours: (N,) bool."""
    distances, _ = cKDTree(points).query(points, k=_NEIGHBOUR + 1)
    reach = distances[:, -1]
    return reach > _ISOLATED * np.median(reach) + 1e-9


def _extents(projected: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return trimmed low and high of coordinates (..., N, 3) along N: (..., 3) each."""
    count = projected.shape[-2]
    cut = int(_TRIM * count)
    part = np.partition(projected, [cut, count - 1 - cut], axis=-2)
    return part[..., cut, :], part[..., count - 1 - cut, :]


def box_in(R: FloatArray, points: FloatArray) -> Start:
    """Return the trimmed box around `points` (N, 3) along the columns of `R`."""
    low, high = _extents(points @ R)
    return Start(R, R @ (low + high) / 2, np.maximum((high - low) / 2, 1e-9))


def upright_rotations(points: FloatArray) -> FloatArray:
    """Rotations about the vertical (18, 3, 3), the one with the smallest box around the points' footprint first."""
    angles = np.arange(_YAWS) * (np.pi / 2 / _YAWS)
    Rs = np.stack([rotation_about("z", angle) for angle in angles])
    low, high = _extents(points @ Rs)
    area = np.prod((high - low)[:, :2], axis=1)
    return Rs[np.argsort(area, kind="stable")]


def _spread_rotations(count: int) -> FloatArray:
    """`count` rotations spread evenly over SO(3) (super-Fibonacci spiral, Alexa 2022): (count, 3, 3)."""
    s = np.arange(count) + 0.5
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    r, big_r = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    return quat_wxyz_to_matrix(
        np.stack([r * np.sin(alpha), r * np.cos(alpha), big_r * np.sin(beta), big_r * np.cos(beta)], axis=1)
    )


_SPREAD = _spread_rotations(200)


def free_rotations(points: FloatArray) -> FloatArray:
    """Rotations (200, 3, 3), relative to the principal axes, smallest box around the points first."""
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    principal = axes.T * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])
    Rs = principal @ _SPREAD
    low, high = _extents(points @ Rs)
    return Rs[np.argsort(np.prod(high - low, axis=1), kind="stable")]
