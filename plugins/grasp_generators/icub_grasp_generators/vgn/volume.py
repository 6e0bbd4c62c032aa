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
from icub_core.geometry import FloatArray
from icub_grasp_generators.vgn.range_view import RangeView

SIZE = 0.3
RESOLUTION = 40
VOXEL = SIZE / RESOLUTION
TRUNCATION = 4 * VOXEL
BELOW = 0.05
"""Meters of the cube that lie below the table top: a gripper's fingers reach that far beyond its origin."""

_NEVER_NEAR = 0.98  # share of the truncation beyond which a voxel counts as not measured
_FIELD = 1.05 * np.sqrt(3) / 2 * SIZE  # meters around the cube's center that the image must show

_grid = (np.stack(np.meshgrid(*3 * [np.arange(RESOLUTION)], indexing="ij"), axis=-1) + 0.5) * VOXEL
_CENTERS: FloatArray = _grid.reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Volume:
    """A cube with axes along the world's.

    Attributes:
        origin: (3,) world position of its lowest corner, meters.
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

    def range_view(self, view: PointCloud) -> RangeView:
        """Return a cloud as seen from its viewpoint. Raises DataError without one, or with one inside the cube."""
        return RangeView(view, self.origin + SIZE / 2, _FIELD)

    def tsdf(self, views: tuple[PointCloud, ...], table_top: float | None = None) -> NDArray[np.float32]:
        """Integrate views, each a cloud with its viewpoint.

        Every view is resampled to a range image from its viewpoint. A voxel's distance is the range of its pixel
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
            distance = self.range_view(view).distance(_CENTERS + self.origin, table_top)
            seen = distance > -TRUNCATION
            total[seen] += np.minimum(distance[seen] / TRUNCATION, 1.0)
            weight += seen
        mean = total / np.maximum(weight, 1.0)
        measured = (weight > 0) & (mean < _NEVER_NEAR) & (mean >= -_NEVER_NEAR)
        field = np.where(measured, (mean + 1) / 2, 0.0).astype(np.float32)
        return field.reshape(3 * (RESOLUTION,))
