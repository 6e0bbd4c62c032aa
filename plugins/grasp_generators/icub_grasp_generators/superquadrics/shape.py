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

_TINY = 1e-12


def _two_norm(a: FloatArray, b: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return (|a|^s + |b|^s)^(1/s) for a, b >= 0 and its derivatives by a, b and s, without overflow."""
    larger = np.maximum(a, b) + _TINY
    t = np.minimum(a, b) / larger + _TINY
    log_t = np.log(t)
    power = np.exp(s * log_t)  # t^s
    total = 1.0 + power
    log_root = np.log(total) / s
    root = np.exp(log_root)
    norm = larger * root
    d_larger = root / total
    log_t *= power
    log_t /= total
    log_t -= log_root
    log_t *= norm
    log_t /= s  # now the derivative by s
    power /= t
    power *= d_larger  # now the derivative by the smaller
    a_is_larger = a >= b
    return norm, np.where(a_is_larger, d_larger, power), np.where(a_is_larger, power, d_larger), log_t


def nested_norm_rows(
    v: FloatArray, s1: FloatArray, s2: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Evaluate N(v) = ((|v1|^s2 + |v2|^s2)^(s1/s2) + |v3|^s1)^(1/s1) and its derivatives.

    Args:
        v: (S, 3, N) S sets of N vectors, components in rows.
        s1: (S, 1) powers above 1.
        s2: (S, 1) powers above 1.

    Returns:
        N (S, N), dN/dv (S, 3, N), dN/ds1 (S, N), dN/ds2 (S, N).
    """
    size = np.abs(v)
    rho, rho_x, rho_y, rho_s = _two_norm(size[:, 0], size[:, 1], s2)
    norm, by_rho, by_z, by_s1 = _two_norm(rho, size[:, 2], s1)
    gradient = np.empty_like(v)
    np.multiply(by_rho, rho_x, out=gradient[:, 0])
    np.multiply(by_rho, rho_y, out=gradient[:, 1])
    gradient[:, 2] = by_z
    rho_s *= by_rho
    return norm, np.copysign(gradient, v, out=gradient), by_s1, rho_s


@dataclass(frozen=True, eq=False)
class Superquadric:
    """One superquadric in space.

    Attributes:
        half_axes: (3,) metres, above 0.
        exponents: (e1, e2): e1 rounds the profile along z, e2 the cross-section; 0.05 is a box's edge, 1 an ellipse.
        T_world_object: (4, 4) pose: the axes are the object's, the origin its centre.
    """

    half_axes: FloatArray
    exponents: FloatArray
    T_world_object: FloatArray

    def __post_init__(self) -> None:
        if self.half_axes.shape != (3,) or not np.all(self.half_axes > 0):
            raise DataError(f"Superquadric.half_axes is {self.half_axes}; expected three lengths above 0, metres")
        if self.exponents.shape != (2,) or not np.all((self.exponents > 0) & (self.exponents < 2)):
            raise DataError(f"Superquadric.exponents is {self.exponents}; expected two values between 0 and 2")
        if not is_rigid(self.T_world_object):
            raise DataError("Superquadric.T_world_object is not a rigid (4, 4) transform")

    @property
    def center(self) -> FloatArray:
        """(3,) centre, world, metres."""
        return self.T_world_object[:3, 3]

    def _norm(self, v: FloatArray, powers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return N (...) and dN/dv (..., 3) at v (..., 3)."""
        rows = np.ascontiguousarray(v.reshape(-1, 3).T)[None]
        norm, gradient, _, _ = nested_norm_rows(rows, powers[None, :1], powers[None, 1:])
        return norm[0].reshape(v.shape[:-1]), gradient[0].T.reshape(v.shape)

    def _gauge(self, points: NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
        """Return G (...) and its gradient (..., 3) in the solid's axes."""
        local = (np.asarray(points) - self.center) @ self.T_world_object[:3, :3]
        norm, by_v = self._norm(local / self.half_axes, 2.0 / self.exponents)
        return norm, by_v / self.half_axes

    def gauge(self, points: NDArray[np.floating]) -> FloatArray:
        """Return G (...) at world points (..., 3): below 1 inside, 1 on the surface, linear along every ray."""
        return self._gauge(points)[0]

    def distance(self, points: NDArray[np.floating]) -> FloatArray:
        """Return the signed distance (...), metres, of world points (..., 3) to the tangent plane they project to.

        The projection is along the ray from the centre: (G - 1) / |grad G|; negative inside. It is the Euclidean
        distance in front of flat faces and, to first order, everywhere near the surface.
        """
        norm, gradient = self._gauge(points)
        return (norm - 1.0) / np.linalg.norm(gradient, axis=-1)

    def normals(self, points: NDArray[np.floating]) -> FloatArray:
        """Return the outward unit normals (..., 3), world, where the rays through world points (..., 3) leave."""
        _, gradient = self._gauge(points)
        gradient /= np.linalg.norm(gradient, axis=-1, keepdims=True)
        return gradient @ self.T_world_object[:3, :3].T

    def support(self, directions: NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
        """Return how far the solid reaches from its centre along unit world directions (..., 3), and where.

        Returns:
            Reach (...), metres, and the points (..., 3), world, that reach furthest.
        """
        R = self.T_world_object[:3, :3]
        reach, by_v = self._norm(np.asarray(directions) @ R * self.half_axes, 2.0 / (2.0 - self.exponents))
        return reach, self.center + (by_v * self.half_axes) @ R.T

    def surface(self, count: int = 1000) -> FloatArray:
        """Return `count` points (count, 3) on the surface, world, metres; always the same ones."""
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
        """Build from half axes (3,), exponents (2,), rotation (3, 3) and centre (3,)."""
        return cls(np.asarray(half_axes, float), np.asarray(exponents, float), make_transform(R, center))
