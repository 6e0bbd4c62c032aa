"""Is there really something where a pose closes the hand? The fitted solid says yes; the cloud may not confirm it.

A drill's superquadric is a box around handle, battery and chuck. The camera sees fewer points than such a box would
show wherever the box is empty or hidden behind other parts, so poses there close around nothing or around what nobody
has seen. What a pose may count on is the ratio of two shares of the image, inside the closing hand: that of the cloud
and that which the solid would have from the same viewpoint.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import FloatArray
from icub_grasp_generators.clouds import CLOUD_POINTS, thin
from icub_grasp_generators.superquadrics.shape import Superquadric

_SURFACE_POINTS = 400
_CONFIRMED = 0.8  # ratio from which on nothing is amiss: outliers and parts that the solid leaves out take their share
_NOTHING = 0.01  # share of the image below which a pose is not scored
_WEIGHT = 2.0


class Evidence:
    """What one camera saw, and what it would have seen of the solid.

    Args:
        shape: The fitted solid.
        points: (N, 3) the cloud, in the same frame.
        viewpoint: (3,) where the camera stood.
        sweep: (3, 2) lowest and highest x, y, z that the closing fingers pass through, in the frame of the poses.
    """

    def __init__(
        self, shape: Superquadric, points: NDArray[np.floating], viewpoint: FloatArray, sweep: FloatArray
    ) -> None:
        self._sweep = sweep
        self._points = thin(points, CLOUD_POINTS)
        surface = shape.surface(_SURFACE_POINTS)
        to_camera = viewpoint - surface
        distance = np.linalg.norm(to_camera, axis=1)
        R = shape.T_world_object[:3, :3]
        scaled = np.linalg.norm((surface - shape.center) @ R / shape.half_axes, axis=1)
        # `surface` casts a ball's even points on the scaled solid, q = D^-1 p: a point stands for the area |q|^3 det(D)
        # times the gauge's gradient, of which the camera sees the part along its ray, smaller with squared distance
        seen = scaled**3 * (shape.gradients(surface) * to_camera).sum(axis=1) / distance**3
        visible = seen > 0
        self._surface, self._share = surface[visible], seen[visible] / seen[visible].sum()

    def cost(self, T: FloatArray) -> FloatArray:
        """Return what poses T (C, 4, 4) cost (C,) for closing where too little was seen: 0 to 2."""
        expected = self._inside(T, self._surface) @ self._share
        found = self._inside(T, self._points).mean(axis=1)
        ratio = np.where(expected > _NOTHING, found / np.maximum(expected, _NOTHING), 1.0)
        return _WEIGHT * np.maximum(1.0 - ratio / _CONFIRMED, 0.0)

    def _inside(self, T: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
        """Say which points (N, 3) the hands at T (C, 4, 4) sweep: (C, N)."""
        R_t = np.swapaxes(T[:, :3, :3], 1, 2)
        # one product of two matrices instead of one for each pose
        local = (R_t.reshape(-1, 3) @ points.T).reshape(len(T), 3, len(points))
        local -= R_t @ T[:, :3, 3:]
        inside: NDArray[np.bool_] = np.all((local > self._sweep[:, :1]) & (local < self._sweep[:, 1:]), axis=1)
        return inside
