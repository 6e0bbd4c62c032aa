"""The superquadric as a norm: distances, support function and their exact derivatives.

A superquadric with half axes a and exponents e1, e2 is the unit ball of the norm

    G(p) = ((|x/a1|^s2 + |y/a2|^s2)^(s1/s2) + |z/a3|^s1)^(1/s1),   s1 = 2/e1, s2 = 2/e2

so the usual inside-outside function is F = G^s1 and F^e1 = G^2. Its dual norm, the same formula with s replaced by
s/(s-1) = 2/(2-e) and division by a replaced by a product, is the support function. One routine therefore serves both.

Source: Solina and Bajcsy 1990 (inside-outside function); thesis 12.3.1 uses its fit for grasping.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import DataError
from icub_core.geometry import FloatArray, is_rigid, make_transform

EXPONENT_RANGE = (0.05, 1.3)
"""Lowest and highest exponent: below, edges are sharper than sensors resolve; above, a diamond mimics a turned box."""

_TINY = 1e-12  # added to coordinates: log 0
_NOTHING = 1e-300  # added to sums of powers that may all underflow


@dataclass
class NormValues:
    """The norm of S sets of N vectors and its logarithmic derivatives.

    Attributes:
        norm: N (S, N).
        shares: (S, 3, N) d log N / d log v_i, which add up to one.
        by_s1: (S, N) d log N / d s1.
        by_s2: (S, N) d log N / d s2.
    """

    norm: FloatArray
    shares: FloatArray
    by_s1: FloatArray
    by_s2: FloatArray


def nested_norm(v: FloatArray, s1: FloatArray, s2: FloatArray) -> NormValues:
    """Evaluate N(v) = ((|v1|^s2 + |v2|^s2)^(s1/s2) + |v3|^s1)^(1/s1) and its derivatives.

    Args:
        v: (S, 3, N) S sets of N vectors, components in rows; |v|^s must not overflow.
        s1: (S, 1) or (S, N) powers above 1.
        s2: (S, 1) or (S, N) powers above 1.
    """
    logs = np.abs(v)
    logs += _TINY
    np.log(logs, out=logs)
    shares = np.empty_like(logs)
    flat = np.exp(logs[:, :2] * s2[:, None])  # |v1|^s2, |v2|^s2
    total = flat[:, 0] + flat[:, 1]
    total += _NOTHING
    flat /= total[:, None]
    log_rho = np.log(total)
    log_rho /= s2
    by_s2 = np.einsum("scn,scn->sn", flat, logs[:, :2])
    by_s2 -= log_rho
    by_s2 /= s2
    by_rho = np.exp(log_rho * s1)
    by_z = np.exp(logs[:, 2] * s1)
    total = by_rho + by_z
    total += _NOTHING
    by_rho /= total
    np.divide(by_z, total, out=shares[:, 2])
    log_norm = np.log(total)
    log_norm /= s1
    log_rho *= by_rho
    by_s1 = shares[:, 2] * logs[:, 2]
    by_s1 += log_rho
    by_s1 -= log_norm
    by_s1 /= s1
    by_s2 *= by_rho
    np.multiply(flat, by_rho[:, None], out=shares[:, :2])
    return NormValues(np.exp(log_norm), shares, by_s1, by_s2)


@dataclass(frozen=True, eq=False)
class Superquadric:
    """One superquadric in space.

    Attributes:
        half_axes: (3,) meters, above 0.
        exponents: (e1, e2): e1 rounds the profile along z, e2 the cross-section; 0.05 is a box's edge, 1 an ellipse.
        T_world_object: (4, 4) pose: the axes are the object's, the origin its center.
    """

    half_axes: FloatArray
    exponents: FloatArray
    T_world_object: FloatArray

    def __post_init__(self) -> None:
        if self.half_axes.shape != (3,) or not np.all(self.half_axes > 0):
            raise DataError(f"Superquadric.half_axes is {self.half_axes}; expected three lengths above 0, meters")
        if self.exponents.shape != (2,) or not np.all((self.exponents > 0) & (self.exponents < 2)):
            raise DataError(f"Superquadric.exponents is {self.exponents}; expected two values between 0 and 2")
        if not is_rigid(self.T_world_object):
            raise DataError("Superquadric.T_world_object is not a rigid (4, 4) transform")

    @property
    def center(self) -> FloatArray:
        """(3,) center, world, meters."""
        return self.T_world_object[:3, 3]

    def _norm(self, v: FloatArray, powers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return N (...) and dN/dv (..., 3) at v (..., 3) of any length."""
        # a norm is homogeneous: at lengths of one no power overflows
        length = np.maximum(np.abs(v).max(axis=-1, keepdims=True), _TINY)
        unit = v / length
        rows = np.ascontiguousarray(unit.reshape(-1, 3).T)[None]
        values = nested_norm(rows, powers[None, :1], powers[None, 1:])
        norm = values.norm[0].reshape(v.shape[:-1])
        shares = values.shares[0].T.reshape(v.shape)
        gradient = norm[..., None] * shares / np.where(np.abs(unit) < _TINY, np.copysign(_TINY, unit), unit)
        return norm * length[..., 0], gradient

    def _gauge(self, points: NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
        """Return G (...) and its gradient (..., 3) in the solid's axes."""
        local = (np.asarray(points) - self.center) @ self.T_world_object[:3, :3]
        norm, by_v = self._norm(local / self.half_axes, 2.0 / self.exponents)
        return norm, by_v / self.half_axes

    def gauge(self, points: NDArray[np.floating]) -> FloatArray:
        """Return G (...) at world points (..., 3): below 1 inside, 1 on the surface, linear along every ray."""
        return self._gauge(points)[0]

    def distance(self, points: NDArray[np.floating]) -> FloatArray:
        """Return the signed distance (...), meters, of world points (..., 3) to the tangent plane they project to.

        The projection is along the ray from the center: (G - 1) / |grad G|; negative inside. It is the Euclidean
        distance in front of flat faces and, to first order, everywhere near the surface.
        """
        norm, gradient = self._gauge(points)
        return (norm - 1.0) / np.linalg.norm(gradient, axis=-1)

    def gradients(self, points: NDArray[np.floating]) -> FloatArray:
        """Return the gradients of G (..., 3), world, 1/meter, at world points (..., 3); constant along every ray."""
        return self._gauge(points)[1] @ self.T_world_object[:3, :3].T

    def normals(self, points: NDArray[np.floating]) -> FloatArray:
        """Return the outward unit normals (..., 3), world, where the rays through world points (..., 3) leave."""
        gradient = self.gradients(points)
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)

    def support(self, directions: NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
        """Return how far the solid reaches from its center along unit world directions (..., 3), and where.

        Returns:
            Reach (...), meters, and the points (..., 3), world, that reach furthest.
        """
        R = self.T_world_object[:3, :3]
        reach, by_v = self._norm(np.asarray(directions) @ R * self.half_axes, 2.0 / (2.0 - self.exponents))
        return reach, self.center + (by_v * self.half_axes) @ R.T

    def surface(self, count: int = 1000) -> FloatArray:
        """Return `count` points (count, 3) on the surface, world, meters; always the same ones."""
        # Fibonacci sphere, cast on the solid as if it were a ball: elongated solids are sampled on all their faces
        k = np.arange(count) + 0.5
        z = 1.0 - 2.0 * k / count
        angle = np.pi * (1.0 + np.sqrt(5.0)) * k
        radius = np.sqrt(1.0 - z * z)
        unit = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
        unit /= self._norm(unit, 2.0 / self.exponents)[0][:, None]
        return (unit * self.half_axes) @ self.T_world_object[:3, :3].T + self.center

    @classmethod
    def from_parts(
        cls, half_axes: FloatArray, exponents: FloatArray, R: FloatArray, center: FloatArray
    ) -> Superquadric:
        """Build from half axes (3,), exponents (2,), rotation (3, 3) and center (3,)."""
        return cls(np.asarray(half_axes, float), np.asarray(exponents, float), make_transform(R, center))
