"""Point clouds before anything is fitted to them: what is refused, thinning, extents."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import DataError
from icub_core.geometry import FloatArray

MIN_POINTS = 20
MAX_EXTENT = 1.0
"""Meters. A larger cloud is a wall or a wrong unit, not something to take into a hand."""
MIN_EXTENT = 1e-3
_LINE = 0.02  # ratio of the second to the first principal deviation below which the points are a line
_OUTLIERS = 0.06  # share cut off at both ends of an extent: outliers must not span the box
_TRIMMED = 0.02  # share cut off where the middle of an object is looked for
_CHECKED = 500  # points that extent and spread are scored by

CLOUD_POINTS = 250
"""Points that hands are tested against."""
MAX_TOUCHED = 4
"""Of them inside the open hand: sensor noise, not an obstacle."""


def check_cloud(points: NDArray[np.floating]) -> None:
    """Raise DataError, one line, unless points (N, 3) are finite and a surface of the size of a graspable object."""
    if len(points) < MIN_POINTS:
        raise DataError(f"the cloud has {len(points)} points; expected at least {MIN_POINTS} on the object's surface")
    if not np.isfinite(points).all():
        bad = int(np.sum(~np.isfinite(points).all(axis=1)))
        raise DataError(f"{bad} of the cloud's {len(points)} points are not finite; drop them before planning")
    sample = thin(points, _CHECKED)
    low, high = trimmed_extents(sample.T, _OUTLIERS)
    extent = float(np.max(high - low))
    if extent > MAX_EXTENT:
        raise DataError(f"the cloud extends over {extent:.3g} m; expected one object of at most {MAX_EXTENT} m")
    deviation = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance(sample)), 0.0))
    if deviation[2] < MIN_EXTENT:
        raise DataError(f"all points of the cloud lie within {deviation[2] * 1e3:.2g} mm; expected a surface")
    if deviation[1] < _LINE * deviation[2]:
        raise DataError("the points of the cloud lie on one line; expected a surface")


def thin(points: NDArray[np.floating], count: int) -> FloatArray:
    """Return a copy of at most `count` of the points (N, 3), drawn at random but always the same ones."""
    if len(points) > count:
        points = points[np.random.default_rng(0).integers(len(points), size=count)]
    return np.array(points, dtype=np.float64)


def covariance(points: FloatArray) -> FloatArray:
    """Covariance (3, 3) of points (N, 3); several times faster than `np.cov`."""
    centered = points - points.mean(axis=0)
    return centered.T @ centered / len(points)


def trimmed_extents(rows: FloatArray, share: float) -> tuple[FloatArray, FloatArray]:
    """Return low and high (...) of coordinates (..., N) without `share` of them at either end."""
    cut = int(share * rows.shape[-1])
    ordered = np.sort(rows, axis=-1)  # up to nine times faster than np.partition for two places
    return ordered[..., cut], ordered[..., -1 - cut]


def center_of(points: NDArray[np.floating], table_top: float | None) -> FloatArray:
    """Estimate the middle (3,) of the object whose visible surface are `points` (N, 3); it stands on the table.

    Raises:
        DataError: No points.
    """
    if len(points) == 0:
        raise DataError("the cloud has no points")
    low, high = trimmed_extents(thin(points, _CHECKED).T, _TRIMMED)
    if table_top is not None:
        low[2] = min(table_top, high[2])
    return (low + high) / 2
