"""The cube that a grasp is looked for in, and its truncated signed distance field (TSDF) from clouds.

Source: Breyer et al. 2020 (VGN): 0.3 m, 40 voxels, truncation of four voxels. Values are those of the original's grid:
(d / truncation + 1) / 2 where 0 < that < 1, that is 0.5 at the surface and more outside of it; 0 wherever nothing was
measured within the truncation, be it free or hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.data import PointCloud
from icub_core.errors import DataError
from icub_core.geometry import FloatArray, look_at

SIZE = 0.3
RESOLUTION = 40
VOXEL = SIZE / RESOLUTION
TRUNCATION = 4 * VOXEL
BELOW = 0.05
"""Metres of the cube that lie below the table top: a gripper's fingers reach that far beyond its origin."""

_NEVER_NEAR = 0.98  # share of the truncation beyond which a voxel counts as not measured
_PIXELS = 128
_FIELD = 1.05 * np.sqrt(3) / 2 * SIZE  # metres around the cube's centre that the picture must show
_NEIGHBOURS = 4  # of eight, that a gap in the picture needs to be filled

_grid = (np.stack(np.meshgrid(*3 * [np.arange(RESOLUTION)], indexing="ij"), axis=-1) + 0.5) * VOXEL
_CENTERS: FloatArray = _grid.reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Volume:
    """A cube with axes along the world's.

    Attributes:
        origin: (3,) world position of its lowest corner, metres.
    """

    origin: FloatArray

    @classmethod
    def around(cls, center: FloatArray, bottom: float) -> Volume:
        """Return the cube whose middle is above or below `center` (3,) and which begins `BELOW` under `bottom`."""
        return cls(np.array([center[0] - SIZE / 2, center[1] - SIZE / 2, bottom - BELOW]))

    def index_of(self, points: FloatArray) -> NDArray[np.intp]:
        """Return the voxels (..., 3) that stand for points (..., 3); also outside of the cube, where none exists."""
        return np.rint((points - self.origin) / VOXEL).astype(np.intp)

    def point_of(self, index: NDArray[np.integer]) -> FloatArray:
        """Return the points (..., 3), world, that voxels stand for: the inverse of `index_of`."""
        return self.origin + VOXEL * np.asarray(index, dtype=np.float64)

    def tsdf(self, views: tuple[PointCloud, ...], table_top: float | None = None) -> NDArray[np.float32]:
        """Integrate views, each a cloud with its viewpoint.

        Every view is resampled to a picture of ranges from its viewpoint. A voxel's distance is the range of its pixel
        less its own, along the ray; several views are averaged where they measured.

        Args:
            views: At least one.
            table_top: World height of a table to put into the field, as far as the object does not hide it.

        Returns:
            (40, 40, 40) float32 with axes x, y, z.

        Raises:
            DataError: No views, or one without viewpoint or inside the cube.
        """
        if not views:
            raise DataError("a signed distance field needs at least one view")
        total, weight = np.zeros(len(_CENTERS)), np.zeros(len(_CENTERS))
        for view in views:
            if view.viewpoint is None:
                raise DataError("a signed distance field needs the viewpoint of every cloud")
            distance = self._distance(view.points, view.viewpoint, table_top)
            seen = distance > -TRUNCATION
            total[seen] += np.minimum(distance[seen] / TRUNCATION, 1.0)
            weight += seen
        mean = total / np.maximum(weight, 1.0)
        measured = (weight > 0) & (mean < _NEVER_NEAR) & (mean >= -_NEVER_NEAR)
        field = np.where(measured, (mean + 1) / 2, 0.0).astype(np.float32)
        return field.reshape(3 * (RESOLUTION,))

    def _distance(self, points: FloatArray, eye: FloatArray, table_top: float | None) -> FloatArray:
        """Signed distance (V,) of every voxel along its ray from `eye`; infinite where the ray meets nothing."""
        middle = self.origin + SIZE / 2
        away = float(np.linalg.norm(middle - eye))
        if away < _FIELD:
            raise DataError(f"the viewpoint is {away:.2f} m from the cube's centre; expected at least {_FIELD:.2f} m")
        R = look_at(eye, middle)[:3, :3]
        focal = (_PIXELS / 2 - 1) / np.tan(np.arcsin(_FIELD / away))
        ranges = _picture((points - eye) @ R, focal)
        local = (_CENTERS + self.origin - eye) @ R
        own = np.linalg.norm(local, axis=1)
        column, row = _pixels(local, focal)
        distance = ranges[row, column] - own
        if table_top is not None:
            down = (_CENTERS[:, 2] + self.origin[2] - eye[2]) / own
            to_table = np.where(down < 0, (table_top - eye[2]) / np.minimum(down, -1e-9), np.inf)
            distance = np.where(np.isinf(distance), to_table - own, distance)
        return distance


def _pixels(local: FloatArray, focal: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return columns and rows (N,) of points (N, 3) in the camera's frame, clipped to the picture."""
    z = np.maximum(local[:, 2:], 1e-9)
    index = np.floor(np.clip(focal * local[:, :2] / z + _PIXELS / 2, 0, _PIXELS - 1)).astype(np.intp)
    return index[:, 0], index[:, 1]


def _picture(local: FloatArray, focal: float) -> FloatArray:
    """Draw points (N, 3) of the camera's frame as ranges (P, P); a pixel takes the mean of what it shows first."""
    size = _PIXELS * _PIXELS
    if len(local) == 0:
        return np.full((_PIXELS, _PIXELS), np.inf)
    column, row = _pixels(local, focal)
    inside = np.max(np.abs(local[:, :2]), axis=1) * focal < (_PIXELS / 2) * local[:, 2]
    pixel, own = (row * _PIXELS + column)[inside], np.linalg.norm(local, axis=1)[inside]
    nearest = np.full(size, np.inf)
    np.minimum.at(nearest, pixel, own)
    front = own < nearest[pixel] + VOXEL
    count = np.bincount(pixel[front], minlength=size)
    mean = np.bincount(pixel[front], own[front], minlength=size) / np.maximum(count, 1)
    picture = np.where(count > 0, mean, np.inf).reshape(_PIXELS, _PIXELS)
    return _without_gaps(_without_gaps(picture))


def _without_gaps(picture: FloatArray) -> FloatArray:
    """Give empty pixels among measured ones the mean of their neighbours: clouds may be sparser than the picture."""
    padded = np.pad(picture, 1, constant_values=np.inf)
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
    return np.where(np.isinf(picture) & (count >= _NEIGHBOURS), mean, picture)
