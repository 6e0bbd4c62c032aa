"""Robust fit of one superquadric to the visible side of an object.

Eleven unknowns: centre, rotation, log half axes, two exponents. The residual of a point is its signed distance to the
tangent plane at the point's radial projection, r = (G - 1) / |grad G| (see `Superquadric.distance`), in which |grad G|
is held fixed during one Gauss-Newton step, so that the Jacobian of G alone, which is exact and cheap, is needed.
Outliers: every point is an inlier with normal noise sigma or belongs to a uniform background; expectation gives its
weight, maximisation is one damped least-squares step. Points on a surface do not say where it ends: a box grown on its
hidden side still contains the visible ones. But a camera spreads its points evenly over the outline, so their likelihood
falls with the outline's area, which ends the solid about one sigma behind the last point. And the solid reaches down to
the table top when there is one.

Source: residual and size term after Solina and Bajcsy 1990 and thesis 12.3.1; mixture after Liu et al. 2022 (EMS).
The released code behind the thesis minimises (F^e1 - 1)^2 by forward differences without any outlier model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from icub_core.geometry import FloatArray
from numpy.typing import NDArray

from icub_grasp_generators.superquadrics.shape import EXPONENT_RANGE, Superquadric, nested_norm
from icub_grasp_generators.superquadrics.start import (
    Start,
    box_in,
    check_cloud,
    free_rotations,
    isolated,
    thin,
    upright_rotations,
)

_COARSE_POINTS = 130
_COARSE_SIGMAS = (0.05, 0.05, 0.03, 0.03, 0.02, 0.02, 0.02, 0.02)  # of the object's size, one per step
_FINE_STEPS = 14
_SIGMA_FLOOR = 0.004  # of the object's size
_OUTLIER_AT = 3.0  # distance, in sigmas, at which inlier and outlier are equally likely
_OUTLINE_WEIGHT = 0.4  # 1 is the likelihood itself; below, edges come closer to the last points
_TABLE_WEIGHT = 0.3  # of the number of points
_START_EXPONENTS = (0.4, 0.5)
_CONVERGED = 1e-4  # step, in units of the object's size and radians
_FLOOR = 1e-6  # least curvature, per point
_N = 11  # centre 0:3, rotation 3:6, log half axes 6:9, exponents 9:11


@dataclass(frozen=True, eq=False)
class SuperquadricFit:
    """A fitted superquadric and how well it explains the cloud.

    Attributes:
        shape: The superquadric, in the cloud's frame.
        rms: Root mean square distance of the inliers to the surface, metres.
        inliers: Share of the points that the fit takes for surface, 0..1.
        noise: Estimated standard deviation of the inliers, metres.
    """

    shape: Superquadric
    rms: float
    inliers: float
    noise: float


@dataclass
class _State:
    """A batch of S candidate solids in the normalised frame."""

    center: FloatArray  # (S, 3)
    R: FloatArray  # (S, 3, 3)
    log_half: FloatArray  # (S, 3)
    exponents: FloatArray  # (S, 2)

    def take(self, index: NDArray[np.intp] | slice) -> _State:
        return _State(self.center[index], self.R[index], self.log_half[index], self.exponents[index])

    def moved(self, step: FloatArray, bounds: FloatArray) -> _State:
        return _State(
            self.center + step[:, :3],
            self.R @ _rotations(step[:, 3:6]),
            np.clip(self.log_half + step[:, 6:9], bounds[0], bounds[1]),
            np.clip(self.exponents + step[:, 9:11], *EXPONENT_RANGE),
        )

    def choose(self, other: _State, take_other: NDArray[np.bool_]) -> _State:
        flags = take_other[:, None]
        return _State(
            np.where(flags, other.center, self.center),
            np.where(flags[..., None], other.R, self.R),
            np.where(flags, other.log_half, self.log_half),
            np.where(flags, other.exponents, self.exponents),
        )


@dataclass
class _Terms:
    """Residuals and Jacobians of a batch at one state."""

    r: FloatArray  # (S, N) distances
    J: FloatArray  # (S, N, 11) with |grad G| held fixed
    r_extra: FloatArray  # (S, K) the table term
    J_extra: FloatArray  # (S, K, 11)


def _rotations(w: FloatArray) -> FloatArray:
    """Rodrigues for a batch (S, 3) -> (S, 3, 3)."""
    angle = np.linalg.norm(w, axis=1)[:, None, None]
    K = np.zeros((len(w), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    K -= np.swapaxes(K, 1, 2)
    return np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (K @ K)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product along the last axis; several times faster than `np.cross` on small batches."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def gauge_jacobian(
    points: FloatArray, center: FloatArray, R: FloatArray, half: FloatArray, exponents: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate G at points (N, 3) for a batch of S solids.

    The eleven parameters are centre, rotation vector w of R exp([w]), log half axes, exponents.

    Returns:
        G (S, N), its Jacobian (S, N, 11), and |grad G| (S, N).
    """
    local = (points - center[:, None]) @ R
    v = local / half[:, None]
    s = 2.0 / exponents
    norm, by_v, by_s1, by_s2 = nested_norm(v, s[:, :1], s[:, 1:])
    by_local = by_v / half[:, None]
    J = np.empty((*norm.shape, _N))
    J[..., 0:3] = -(by_local @ np.swapaxes(R, 1, 2))
    J[..., 3:6] = _cross(by_local, local)
    J[..., 6:9] = -by_v * v
    J[..., 9] = by_s1 * (-0.5 * s[:, :1] ** 2)
    J[..., 10] = by_s2 * (-0.5 * s[:, 1:] ** 2)
    return norm, J, np.sqrt(np.einsum("snk,snk->sn", by_local, by_local))


def support_jacobian(
    direction: FloatArray, R: FloatArray, half: FloatArray, exponents: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Evaluate how far S solids reach from their centres along `direction` (3,), unit, world.

    Returns:
        Reach (S,) and its Jacobian (S, 11) by the parameters of `gauge_jacobian`.
    """
    u = np.swapaxes(R, 1, 2) @ direction
    v = half * u
    q = 2.0 / (2.0 - exponents)
    reach, by_v, by_q1, by_q2 = nested_norm(v, q[:, 0], q[:, 1])
    J = np.zeros((len(reach), _N))
    J[:, 3:6] = _cross(half * by_v, u)
    J[:, 6:9] = by_v * v
    J[:, 9] = by_q1 * 0.5 * q[:, 0] ** 2
    J[:, 10] = by_q2 * 0.5 * q[:, 1] ** 2
    return reach, J


def outline_area(view: FloatArray, R: FloatArray, half: FloatArray, power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Logarithm of the area of S solids' outlines seen along unit directions `view` (S, 3), up to a constant.

    log (sum_i T_i^p)^(1/p) with T_i = |d_i| a_j a_k in the solid's axes: exact for boxes (p = 1) and ellipsoids (2).

    Returns:
        The logarithm (S,) and its Jacobian (S, 11) by the parameters of `gauge_jacobian`.
    """
    d = np.einsum("ski,sk->si", R, view)
    face = np.roll(half, -1, axis=1) * np.roll(half, 1, axis=1)
    p = power[:, None]
    raised = (np.abs(d) * face + 1e-9) ** p
    total = raised.sum(axis=1, keepdims=True)
    J = np.zeros((len(half), _N))
    by_d = np.sign(d) * face * (np.abs(d) * face + 1e-9) ** (p - 1.0) / total
    J[:, 3:6] = _cross(by_d, d)
    J[:, 6:9] = 1.0 - raised / total
    return np.log(total[:, 0]) / power, J


def _terms(state: _State, points: FloatArray, table: float | None) -> _Terms:
    half = np.exp(state.log_half)
    norm, J, slope = gauge_jacobian(points, state.center, state.R, half, state.exponents)
    r = (norm - 1.0) / slope
    J /= slope[..., None]
    if table is None:
        return _Terms(r, J, np.zeros((len(r), 0)), np.zeros((len(r), 0, _N)))
    root = np.sqrt(_TABLE_WEIGHT * len(points))
    reach, J_reach = support_jacobian(np.array([0.0, 0.0, -1.0]), state.R, half, state.exponents)
    J_table = -root * J_reach
    J_table[:, 2] += root
    return _Terms(r, J, (root * (state.center[:, 2] - reach - table))[:, None], J_table[:, None])


def _weights(r: FloatArray, sigma: FloatArray) -> FloatArray:
    """Probability that a point is surface, given its distance (S, N) and the noise (S,)."""
    return 1.0 / (1.0 + np.exp(np.minimum(0.5 * ((r / sigma[:, None]) ** 2 - _OUTLIER_AT**2), 50.0)))


def _outline(state: _State, view: FloatArray) -> tuple[FloatArray, FloatArray]:
    return outline_area(view, state.R, np.exp(state.log_half), 1.0 + np.minimum(state.exponents.prod(axis=1), 1.0))


def _view(terms: _Terms, sigma: FloatArray) -> FloatArray:
    """Direction to the viewer (S, 3), which a cloud does not carry: the mean of the visible normals."""
    outward = -np.einsum("sn,snk->sk", _weights(terms.r, sigma), terms.J[..., :3])
    return outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)


def _cost(state: _State, terms: _Terms, sigma: FloatArray, view: FloatArray) -> FloatArray:
    """Negative log likelihood of the mixture, times sigma^2, plus the table term: (S,)."""
    z = 0.5 * (_OUTLIER_AT**2 - (terms.r / sigma[:, None]) ** 2)
    likelihood = np.logaddexp(0.0, z).sum(axis=1) - _OUTLINE_WEIGHT * terms.r.shape[1] * _outline(state, view)[0]
    return -(sigma**2) * likelihood + 0.5 * (terms.r_extra**2).sum(axis=1)


def _step(
    state: _State, terms: _Terms, sigma: FloatArray, view: FloatArray, damping: FloatArray, bounds: FloatArray
) -> FloatArray:
    """One damped Gauss-Newton step (S, 11) that does not push parameters through their bounds."""
    w = _weights(terms.r, sigma)
    weighted = np.swapaxes(terms.J * w[..., None], 1, 2)
    extra = np.swapaxes(terms.J_extra, 1, 2)
    H = weighted @ terms.J + extra @ terms.J_extra
    g = (weighted @ terms.r[..., None] + extra @ terms.r_extra[..., None])[..., 0]
    g += (_OUTLINE_WEIGHT * sigma**2 * terms.r.shape[1])[:, None] * _outline(state, view)[1]
    value = np.concatenate([state.log_half, state.exponents], axis=1)
    low = np.concatenate([np.broadcast_to(bounds[0], (3,)), np.full(2, EXPONENT_RANGE[0])])
    high = np.concatenate([np.broadcast_to(bounds[1], (3,)), np.full(2, EXPONENT_RANGE[1])])
    stuck = np.zeros(g.shape, dtype=bool)
    stuck[:, 6:] = ((value <= low) & (g[:, 6:] > 0)) | ((value >= high) & (g[:, 6:] < 0))
    free = (~stuck).astype(float)
    H = H * free[:, :, None] * free[:, None, :]
    diagonal = np.einsum("sii->si", H)
    # the floor keeps directions that nothing determines (the turn of a cylinder about its axis) at rest
    diagonal += damping[:, None] * diagonal + _FLOOR * terms.r.shape[1] + stuck
    return -np.linalg.solve(H, (g * free)[..., None])[..., 0]


def _descend(
    state: _State, points: FloatArray, table: float | None, bounds: FloatArray, sigmas: tuple[float, ...], fixed: bool
) -> tuple[_State, _Terms, FloatArray]:
    """Take one step per entry of `sigmas`; unless `fixed`, sigma is estimated from the weighted residuals instead."""
    damping = np.full(len(state.center), 1e-2)
    sigma = np.full(len(state.center), sigmas[0])
    terms = _terms(state, points, table)
    for limit in sigmas:
        if fixed:
            sigma = np.full(len(state.center), limit)
        else:
            w = _weights(terms.r, sigma)
            estimate = np.sqrt((w * terms.r**2).sum(axis=1) / np.maximum(w.sum(axis=1), 1.0))
            sigma = np.clip(1.1 * estimate, limit, sigma)
        view = _view(terms, sigma)
        step = _step(state, terms, sigma, view, damping, bounds)
        trial = state.moved(step, bounds)
        trial_terms = _terms(trial, points, table)
        better = _cost(trial, trial_terms, sigma, view) < _cost(state, terms, sigma, view)
        state = state.choose(trial, better)
        terms = _Terms(
            np.where(better[:, None], trial_terms.r, terms.r),
            np.where(better[:, None, None], trial_terms.J, terms.J),
            np.where(better[:, None], trial_terms.r_extra, terms.r_extra),
            np.where(better[:, None, None], trial_terms.J_extra, terms.J_extra),
        )
        damping = np.clip(np.where(better, damping * 0.2, damping * 8.0), 1e-7, 1e3)
        if not fixed and bool(np.all(better)) and float(np.abs(step).max()) < _CONVERGED:
            break
    return state, terms, sigma


_AXIS_ORDERS = ([0, 1, 2], [1, 2, 0], [2, 0, 1])


def _batch(starts: list[Start]) -> _State:
    """Every start with each of its axes as the axis of revolution."""
    center = np.repeat([s.center for s in starts], 3, axis=0)
    R = np.stack([s.R[:, order] for s in starts for order in _AXIS_ORDERS])
    half = np.stack([s.half[order] for s in starts for order in _AXIS_ORDERS])
    return _State(center, R, np.log(half), np.tile(_START_EXPONENTS, (len(center), 1)))


def fit_superquadric(points: NDArray[np.floating], table_top: float | None = None) -> SuperquadricFit:
    """Fit a superquadric to surface points of one object, seen from one side or from all.

    Args:
        points: (N, 3) metres; the third axis points up when `table_top` is given.
        table_top: Height of the table on which the object stands, metres. The solid then reaches down to it, and the
            starts have an upright axis. None for an object in the air.

    Returns:
        The fit; the same points give the same fit.

    Raises:
        DataError: The cloud has fewer than 20 points, is not finite, spans more than a metre, or lies on a line.
    """
    points = np.asarray(points)
    check_cloud(points)
    sample = thin(points)
    dense = sample[~isolated(sample)]
    if len(dense) < len(sample) // 2:  # a cloud that is sparse everywhere
        dense = sample
    origin = np.median(dense, axis=0)
    low, high = np.quantile(dense, [0.02, 0.98], axis=0)
    size = float(np.linalg.norm(high - low)) / 2
    sample, dense = (sample - origin) / size, (dense - origin) / size
    table = None if table_top is None else (table_top - origin[2]) / size

    probe = dense[:: max(1, len(dense) // _COARSE_POINTS)]
    if table is None:
        starts = [box_in(R, probe) for R in free_rotations(probe)[:2]]
    else:
        starts = [_down_to(box_in(R, probe), table) for R in upright_rotations(probe)[:2]]
    bounds = np.log(np.array([0.02, 2.0]))
    coarse = sample[:: max(1, len(sample) // _COARSE_POINTS)]
    state, terms, sigma = _descend(_batch(starts), coarse, table, bounds, _COARSE_SIGMAS, fixed=True)
    best = int(np.argmin(_cost(state, terms, sigma, _view(terms, sigma))))
    fine = (_COARSE_SIGMAS[-1],) + (_SIGMA_FLOOR,) * _FINE_STEPS
    state, terms, sigma = _descend(state.take(slice(best, best + 1)), sample, table, bounds, fine, fixed=False)
    return _result(state, terms, sigma, origin, size)


def _down_to(start: Start, table: float) -> Start:
    """Extend an upright box down to the table."""
    top = start.center[2] + start.half[2]
    half = max((top - table) / 2, 1e-3)
    return Start(start.R, np.array([start.center[0], start.center[1], top - half]), np.array([*start.half[:2], half]))


def _result(state: _State, terms: _Terms, sigma: FloatArray, origin: FloatArray, size: float) -> SuperquadricFit:
    w = _weights(terms.r, sigma)[0]
    rms = float(np.sqrt((w * terms.r[0] ** 2).sum() / max(w.sum(), 1e-9)))
    shape = Superquadric.from_parts(
        np.exp(state.log_half[0]) * size, state.exponents[0], state.R[0], state.center[0] * size + origin
    )
    return SuperquadricFit(shape, rms * size, float(w.mean()), float(sigma[0]) * size)
