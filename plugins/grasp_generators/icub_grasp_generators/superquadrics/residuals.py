"""Values and exact Jacobians that the fit is made of, for a batch of S solids at once.

The eleven parameters are: centre 0:3, rotation vector w of R exp([w]) 3:6, log half axes 6:9, exponents e1, e2 9:11.
Arrays are laid out with the points last, which numpy walks fastest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from icub_core.geometry import FloatArray
from icub_grasp_generators.superquadrics.shape import nested_norm_rows

PARAMETERS = 11


@dataclass
class Solids:
    """S superquadrics as bare arrays.

    Attributes:
        R: (S, 3, 3) rotations.
        vector: (S, 8) centre, log half axes, exponents.
    """

    R: FloatArray
    vector: FloatArray

    @property
    def center(self) -> FloatArray:
        """(S, 3)."""
        return self.vector[:, :3]

    @property
    def half(self) -> FloatArray:
        """(S, 3) half axes."""
        return np.exp(self.vector[:, 3:6])

    @property
    def exponents(self) -> FloatArray:
        """(S, 2)."""
        return self.vector[:, 6:]

    def moved(self, step: FloatArray, low: FloatArray, high: FloatArray) -> Solids:
        """Return the solids after steps (S, 11), with `vector` clipped to `low` and `high` (8,)."""
        change = np.concatenate([step[:, :3], step[:, 6:]], axis=1)
        return Solids(self.R @ rotations(step[:, 3:6]), np.minimum(np.maximum(self.vector + change, low), high))


def rotations(w: FloatArray) -> FloatArray:
    """Rotation vectors (S, 3) to matrices (S, 3, 3), by the Cayley transform of equal first order.

    exp([w]) up to third order; each result is a rotation for every w, so that steps never leave the group.
    """
    x, y, z = 0.5 * w[:, 0], 0.5 * w[:, 1], 0.5 * w[:, 2]
    n = x * x + y * y + z * z
    R = np.empty((len(w), 3, 3))
    R[:, 0, 0], R[:, 0, 1], R[:, 0, 2] = 1 + 2 * x * x - n, 2 * (x * y - z), 2 * (x * z + y)
    R[:, 1, 0], R[:, 1, 1], R[:, 1, 2] = 2 * (x * y + z), 1 + 2 * y * y - n, 2 * (y * z - x)
    R[:, 2, 0], R[:, 2, 1], R[:, 2, 2] = 2 * (x * z - y), 2 * (y * z + x), 1 + 2 * z * z - n
    R /= (1 + n)[:, None, None]
    return R


def _cross_rows(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Cross product of (S, 3, ...) along axis 1 into `out`."""
    out[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    out[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    out[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def gauge_jacobian(solids: Solids, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate the norm G at points (3, N).

    Returns:
        G (S, N), its Jacobian (S, 11, N), and |grad G| (S, N).
    """
    R, half = solids.R, solids.half
    R_t = R.transpose(0, 2, 1)
    local = R_t @ points - R_t @ solids.center[:, :, None]
    v = local / half[:, :, None]
    s = 2.0 / solids.exponents
    norm, by_v, by_s1, by_s2 = nested_norm_rows(v, s[:, :1], s[:, 1:])
    J = np.empty((len(R), PARAMETERS, points.shape[1]))
    np.multiply(by_v, v, out=J[:, 6:9])
    by_v /= half[:, :, None]
    J[:, 0:3] = R @ by_v
    _cross_rows(local, by_v, J[:, 3:6])
    slope = np.sqrt(by_v[:, 0] ** 2 + by_v[:, 1] ** 2 + by_v[:, 2] ** 2)
    s *= s
    np.multiply(by_s1, 0.5 * s[:, :1], out=J[:, 9])
    np.multiply(by_s2, 0.5 * s[:, 1:], out=J[:, 10])
    np.negative(J, out=J)
    return norm, J, slope


def support_jacobian(solids: Solids, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Evaluate how far the solids reach from their centres along `direction` (3,), a unit vector.

    Returns:
        Reach (S,) and its Jacobian (S, 11).
    """
    half = solids.half
    u = (direction @ solids.R)[:, :, None]
    v = half[:, :, None] * u
    q = 2.0 / (2.0 - solids.exponents)
    reach, by_v, by_q1, by_q2 = nested_norm_rows(v, q[:, :1], q[:, 1:])
    J = np.zeros((len(half), PARAMETERS, 1))
    _cross_rows(half[:, :, None] * by_v, u, J[:, 3:6])
    J[:, 6:9] = by_v * v
    J[:, 9] = by_q1 * 0.5 * q[:, :1] ** 2
    J[:, 10] = by_q2 * 0.5 * q[:, 1:] ** 2
    return reach[:, 0], J[..., 0]


def viewers(solids: Solids, normals: FloatArray) -> FloatArray:
    """Estimate the directions to the viewer (S, 3), up to length, from the mean visible normals (S, 3).

    A camera sees each piece of surface in proportion to its cosine, so the mean normal is M d with M the integral of
    n n^T over the surface; in the solid's axes M is diagonal, for a box with the areas of its faces.
    """
    half = solids.half
    local = (normals[:, None] @ solids.R)[:, 0]
    local *= half / half.prod(axis=1, keepdims=True)
    return (solids.R @ local[:, :, None])[..., 0]


def outline_area(solids: Solids, view: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Logarithm of the area of the outlines of the solids' boxes seen from directions `view` (S, 3), up to a constant.

    log sum_i |d_i| a_j a_k with d the direction in the solid's axes. For rounded solids it is not exact; it is a weak
    term, of which only the sense counts there.

    Returns:
        The logarithm (S,) and its Jacobian (S, 11).
    """
    half = solids.half
    d = (view[:, None, :] @ solids.R)[:, 0]
    face = half.prod(axis=1, keepdims=True) / half
    seen = np.abs(d) * face
    total = seen.sum(axis=1, keepdims=True) + 1e-12
    J = np.zeros((len(half), PARAMETERS))
    _cross_rows(np.copysign(face / total, d), d, J[:, 3:6])
    J[:, 6:9] = 1.0 - seen / total
    return np.log(total[:, 0]), J
