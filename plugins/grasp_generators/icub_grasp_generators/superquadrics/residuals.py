"""Values and exact Jacobians that the fit is made of, for a batch of S solids at once.

The eleven parameters are: centre 0:3, rotation vector w of R exp([w]) 3:6, log half axes 6:9, exponents e1, e2 9:11.
Arrays are laid out with the points last, which numpy walks fastest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import FloatArray
from icub_grasp_generators.superquadrics.shape import nested_norm

PARAMETERS = 11
_TINY = 1e-12  # added to divisors that may be zero


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

    def take(self, index: NDArray[np.intp]) -> Solids:
        """Return copies of the solids with these numbers."""
        return Solids(self.R[index], self.vector[index])

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
    """Cross product of (S, 3, ...) along axis 1 into `out`."""
    out[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    out[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    out[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


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


def evaluate(solids: Solids, points: FloatArray, direction: FloatArray | None = None) -> SolidValues:
    """Evaluate the norm G at points (3, N) and, when asked for, how far the solids reach along a direction.

    Args:
        solids: S of them.
        points: (3, N).
        direction: (3,) unit vector. The support function is the dual norm and is computed in the same sweep, as one
            more column: the calls, not the arithmetic, are what one vector costs.
    """
    R, half, exponents = solids.R, solids.half, solids.exponents
    R_t = R.transpose(0, 2, 1)
    count = points.shape[1]
    column = half[:, :, None]
    local = R_t @ points
    local -= R_t @ solids.center[:, :, None]
    s = 2.0 / exponents
    if direction is None:
        v, s1, s2 = local / column, s[:, :1], s[:, 1:]
    else:
        u = direction @ R
        v = np.empty((len(R), 3, count + 1))
        np.divide(local, column, out=v[:, :, :count])
        v[:, :, count] = half * u
        s1, s2 = np.empty((2, len(R), count + 1))
        s1[:, :count], s2[:, :count] = s[:, :1], s[:, 1:]
        q = 2.0 / (2.0 - exponents)
        s1[:, count], s2[:, count] = q[:, 0], q[:, 1]
    values = nested_norm(v, s1, s2)
    norm = values.norm

    J = np.empty((len(R), PARAMETERS, norm.shape[1]))
    np.multiply(values.shares, -norm[:, None], out=J[:, 6:9])
    by_local = J[:, 6:9, :count] / (local + np.copysign(_TINY, local))  # -dG/dlocal
    np.matmul(R, by_local, out=J[:, 0:3, :count])
    _cross_rows(local, by_local, J[:, 3:6, :count])
    slope = np.sqrt(np.einsum("skn,skn->sn", by_local, by_local))
    norm_half = -0.5 * norm
    np.multiply(values.by_s1, norm_half * s1**2, out=J[:, 9])
    np.multiply(values.by_s2, norm_half * s2**2, out=J[:, 10])
    if direction is None:
        return SolidValues(norm, J, slope)
    # the dual's powers grow with the exponents and its argument with the axes, hence the opposite signs
    J_reach = -J[:, :, count]
    J_reach[:, 0:3] = 0.0
    by_u = J_reach[:, 6:9] / (u + np.copysign(_TINY, u))
    _cross_rows(by_u, u, J_reach[:, 3:6])
    return SolidValues(norm[:, :count], J[:, :, :count], slope, norm[:, count], J_reach)


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
    face = 1.0 / solids.half  # up to the factor a1 a2 a3
    seen = np.abs(d) * face
    total = seen.sum(axis=1, keepdims=True) + _TINY
    J = np.zeros((len(d), PARAMETERS))
    _cross_rows(np.copysign(face / total, d), d, J[:, 3:6])
    J[:, 6:9] = 1.0 - seen / total
    return J
