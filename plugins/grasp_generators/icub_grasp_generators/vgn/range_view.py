"""A cloud as a range image from its viewpoint: what space is free, what is surface, what is hidden."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.data import PointCloud
from icub_core.errors import DataError
from icub_core.geometry import FloatArray, look_at

_PIXELS = 128
_SAME_SURFACE = 0.0075  # meters of range within which the points of a pixel are averaged
_NEIGHBORS = 4  # of eight, that a gap in the image needs to be filled


class RangeView:
    """Resamples a cloud to a range image; distances to it are read along the rays.

    Args:
        cloud: With its viewpoint.
        middle: (3,) point that the image is centered on.
        radius: Meters around it that the image shows.

    Raises:
        DataError: No viewpoint, or one closer than `radius`.
    """

    def __init__(self, cloud: PointCloud, middle: FloatArray, radius: float) -> None:
        if cloud.viewpoint is None:
            raise DataError("a signed distance field needs the viewpoint of every cloud")
        self._eye = cloud.viewpoint
        away = float(np.linalg.norm(middle - self._eye))
        if away < radius:
            raise DataError(f"the viewpoint is {away:.2f} m from the cube's center; expected at least {radius:.2f} m")
        self._R = look_at(self._eye, middle)[:3, :3]
        self._focal = (_PIXELS / 2 - 1) / np.tan(np.arcsin(radius / away))
        self._ranges = _image((cloud.points - self._eye) @ self._R, self._focal)

    def distance(self, points: FloatArray, table_top: float | None = None) -> FloatArray:
        """Return the signed distance (N,) of points (N, 3) along their rays: positive before the surface.

        Infinite where the ray meets nothing.

        Args:
            points: World, meters.
            table_top: World height of a table that rays beside the object end on.
        """
        local = (points - self._eye) @ self._R
        own = np.linalg.norm(local, axis=1)
        column, row = _pixels(local, self._focal)
        distance = self._ranges[row, column] - own
        if table_top is not None:
            down = (points[:, 2] - self._eye[2]) / own
            to_table = np.where(down < 0, (table_top - self._eye[2]) / np.minimum(down, -1e-9), np.inf)
            distance = np.where(np.isinf(distance), to_table - own, distance)
        return distance


def _pixels(local: FloatArray, focal: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return columns and rows (N,) of points (N, 3) in the camera's frame, clipped to the image."""
    z = np.maximum(local[:, 2:], 1e-9)
    index = np.floor(np.clip(focal * local[:, :2] / z + _PIXELS / 2, 0, _PIXELS - 1)).astype(np.intp)
    return index[:, 0], index[:, 1]


def _image(local: FloatArray, focal: float) -> FloatArray:
    """Draw points (N, 3) of the camera's frame as ranges (P, P); a pixel takes the mean of what it shows first."""
    size = _PIXELS * _PIXELS
    if len(local) == 0:
        return np.full((_PIXELS, _PIXELS), np.inf)
    column, row = _pixels(local, focal)
    inside = np.max(np.abs(local[:, :2]), axis=1) * focal < (_PIXELS / 2) * local[:, 2]
    pixel, own = (row * _PIXELS + column)[inside], np.linalg.norm(local, axis=1)[inside]
    nearest = np.full(size, np.inf)
    np.minimum.at(nearest, pixel, own)
    front = own < nearest[pixel] + _SAME_SURFACE
    count = np.bincount(pixel[front], minlength=size)
    mean = np.bincount(pixel[front], own[front], minlength=size) / np.maximum(count, 1)
    image = np.where(count > 0, mean, np.inf).reshape(_PIXELS, _PIXELS)
    return _without_gaps(_without_gaps(image))


def _without_gaps(image: FloatArray) -> FloatArray:
    """Give empty pixels among measured ones the mean of their neighbors: clouds may be sparser than the image."""
    padded = np.pad(image, 1, constant_values=np.inf)
    around = np.stack(
        [
            padded[1 + i : 1 + i + _PIXELS, 1 + j : 1 + j + _PIXELS]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if (i, j) != (0, 0)
        ]
    )
    known = np.isfinite(around)
    count = known.sum(axis=0)
    mean = np.where(known, around, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(np.isinf(image) & (count >= _NEIGHBORS), mean, image)
