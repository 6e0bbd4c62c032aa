"""Values and exact Jacobians that the fit is made of, for a batch of S solids at once.

The eleven parameters are: center 0:3, rotation vector w of R exp([w]) 3:6, log half axes 6:9, exponents e1, e2 9:11.
Arrays are laid out with the points last, which numpy walks fastest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import FloatArray
from icub_grasp_generators.superquadrics.shape import nested_norm

PARAMETERS = 11
_TINY = 1e-12  # added to divisors that may be zero
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]  # axes after an axis, in turn


@dataclass(frozen=True)
class Solids:
    """S superquadrics as bare arrays, which nobody writes to.

    Attributes:
        R: (S, 3, 3) rotations.
        vector: (S, 8) center, log half axes, exponents.
    """

    R: FloatArray
    vector: FloatArray

    @property
    def center(self) -> FloatArray:
        """(S, 3)."""
        return self.vector[:, :3]

    @cached_property
    def half(self) -> FloatArray:
        """(S, 3) half axes."""
        half: FloatArray = np.exp(self.vector[:, 3:6])
        return half

    @property
    def exponents(self) -> FloatArray:
        """(S, 2)."""
        return self.vector[:, 6:]

    def take(self, index: NDArray[np.intp]) -> Solids:
        """Return the solids with these numbers."""
        return Solids(self.R[index], self.vector[index])

    def where(self, chosen: NDArray[np.bool_], other: Solids) -> Solids:
        """Return these solids where `chosen` (S,) holds, those of `other` elsewhere."""
        return Solids(
            np.where(chosen[:, None, None], self.R, other.R), np.where(chosen[:, None], self.vector, other.vector)
        )

    def moved(self, step: FloatArray, low: FloatArray, high: FloatArray) -> Solids:
        """Return the solids after steps (S, 11), with `vector` clipped to `low` and `high` (8,)."""
        change = np.concatenate([step[:, :3], step[:, 6:]], axis=1)
        return Solids(self.R @ rotations(step[:, 3:6]), np.minimum(np.maximum(self.vector + change, low), high))


def rotations(w: FloatArray) -> FloatArray:
    """Rotation vectors (S, 3) to matrices (S, 3, 3), by the Cayley transform.

    It agrees with exp([w]) to second order and gives a rotation for every w, so that steps never leave the group.
    """
    return np.array([_cayley(*(0.5 * w_s).tolist()) for w_s in w])


def _cayley(x: float, y: float, z: float) -> list[list[float]]:
    xx, yy, zz = x * x, y * y, z * z
    f = 2.0 / (1.0 + xx + yy + zz)
    return [
        [1.0 - f * (yy + zz), f * (x * y - z), f * (x * z + y)],
        [f * (x * y + z), 1.0 - f * (xx + zz), f * (y * z - x)],
        [f * (x * z - y), f * (y * z + x), 1.0 - f * (xx + yy)],
    ]


def _cross_rows(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Cross product of (S, 5, ...) along axis 1, whose last two rows repeat the first two, into `out` (S, 3, ...)."""
    np.multiply(a[:, 1:4], b[:, 2:5], out=out)
    out -= a[:, 2:5] * b[:, 1:4]


def columns(points: FloatArray, direction: FloatArray | None) -> FloatArray:
    """Lay points (N, 3) out as homogeneous columns (4, N), with a direction (3,) as one more column."""
    rows = np.ones((4, len(points) + (direction is not None)))
    rows[:3, : len(points)] = points.T
    if direction is not None:
        rows[:3, -1], rows[3, -1] = direction, 0.0
    return rows


@dataclass
class SolidValues:
    """What `evaluate` returns; J are Jacobians by the eleven parameters.

    Attributes:
        gauge: G (S, N) at the points.
        J_gauge: (S, 11, N).
        slope: |grad G| (S, N).
        reach: (S,) support function along the direction, or None.
        J_reach: (S, 11), or None.
    """

    gauge: FloatArray
    J_gauge: FloatArray
    slope: FloatArray
    reach: FloatArray | None = None
    J_reach: FloatArray | None = None


def evaluate(solids: Solids, rows: FloatArray, with_direction: bool) -> SolidValues:
    """Evaluate the norm G at points and, when asked for, how far the solids reach along a direction.

    Args:
        solids: S of them.
        rows: Points, and perhaps the direction, as `columns` lays them out.
        with_direction: The last column is a direction. The support function is the dual norm and is computed in the
            same sweep: the calls, not the arithmetic, are what one vector costs.
    """
    R, half, exponents = solids.R, solids.half, solids.exponents
    R_t = R.transpose(0, 2, 1)
    T = np.empty((len(R), 3, 4))
    T[:, :, :3] = R_t
    np.negative((R_t @ solids.center[:, :, None])[..., 0], out=T[:, :, 3])
    width = rows.shape[1]
    count = width - with_direction
    local = np.empty((len(R), 5, width))
    np.matmul(T, rows, out=local[:, :3])
    local[:, 3:] = local[:, :2]
    v = local[:, :3] / half[:, :, None]
    s = (2.0 / exponents).T[:, :, None]
    if with_direction:
        v[:, :, count] = half * local[:, :3, count]
        powers = np.empty((2, len(R), width))
        powers[:] = s
        powers[:, :, count] = (2.0 / (2.0 - exponents)).T
        s = powers
    values = nested_norm(v, s[0], s[1])
    norm = values.norm

    J = np.empty((len(R), PARAMETERS, width))
    np.multiply(values.shares, -norm[:, None], out=J[:, 6:9])
    by_local = np.empty_like(local)
    divisor = np.copysign(_TINY, local[:, :3])
    divisor += local[:, :3]
    np.divide(J[:, 6:9], divisor, out=by_local[:, :3])  # -dG/dlocal
    by_local[:, 3:] = by_local[:, :2]
    np.matmul(R, by_local[:, :3], out=J[:, 0:3])
    _cross_rows(local, by_local, J[:, 3:6])
    slope = np.sqrt(np.einsum("skn,skn->sn", by_local[:, :3], by_local[:, :3]))
    by_exponents = s * s * (-0.5 * norm)
    np.multiply(values.by_s1, by_exponents[0], out=J[:, 9])
    np.multiply(values.by_s2, by_exponents[1], out=J[:, 10])
    if not with_direction:
        return SolidValues(norm, J, slope)
    # the dual's powers grow with the exponents and its argument with the axes, hence the opposite signs; a turn acts
    # on its argument as on a point
    J_reach = -J[:, :, count]
    J_reach[:, 0:3] = 0.0
    J_reach[:, 3:6] = J[:, 3:6, count]
    return SolidValues(norm[:, :count], J[:, :, :count], slope[:, :count], norm[:, count], J_reach)


def viewers(solids: Solids, normals: FloatArray) -> FloatArray:
    """Estimate the directions to the viewer (S, 3), up to length, from the mean visible normals (S, 3).

    A camera sees each piece of surface in proportion to its cosine, so the mean normal is M d with M the integral of
    n n^T over the surface; in the solid's axes M is diagonal, for a box with the areas of its faces.
    """
    half = solids.half
    local = (normals[:, None] @ solids.R)[:, 0]
    local *= half / half.prod(axis=1, keepdims=True)
    return (solids.R @ local[:, :, None])[..., 0]


def outline(solids: Solids, view: FloatArray) -> FloatArray:
    """Logarithm (S,) of the area of the outlines of the solids' boxes, seen from directions `view` (S, 3).

    log sum_i |d_i| a_j a_k, up to a constant, with d the direction in the solid's axes. For rounded solids it is not
    exact; it is a weak term, of which only the sense counts there.
    """
    half = solids.half
    d = (view[:, None, :] @ solids.R)[:, 0]
    return np.log((np.abs(d) / half).sum(axis=1) * half.prod(axis=1) + _TINY)


def outline_jacobian(solids: Solids, view: FloatArray) -> FloatArray:
    """Differentiate `outline` by the eleven parameters: (S, 11)."""
    d = (view[:, None, :] @ solids.R)[:, 0]
    seen = np.abs(d) / solids.half  # areas, up to the factor a1 a2 a3
    seen /= seen.sum(axis=1, keepdims=True) + _TINY
    J = np.zeros((len(d), PARAMETERS))
    by_d = seen / (d + np.copysign(_TINY, d))
    J[:, 3:6] = by_d[:, _NEXT] * d[:, _AFTER] - by_d[:, _AFTER] * d[:, _NEXT]
    np.subtract(1.0, seen, out=J[:, 6:9])
    return J
