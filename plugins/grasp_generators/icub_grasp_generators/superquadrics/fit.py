"""Robust fit of one superquadric to the visible side of an object.

Eleven unknowns: centre, rotation, log half axes, two exponents. The residual of a point is its signed distance to the
tangent plane at the point's radial projection, r = (G - 1) / |grad G| (see `Superquadric.distance`), in which |grad G|
is held fixed during one Gauss-Newton step, so that the Jacobian of G alone, which is exact and cheap, is needed.
Outliers: every point is an inlier with normal noise sigma or belongs to a uniform background; expectation gives its
weight, maximisation is one damped least-squares step. Points on a surface do not say where it ends: a box grown on its
hidden side still contains the visible ones. But a camera spreads its points evenly over the outline, so the likelihood
falls with the outline's area, which ends the solid about one sigma behind the last point. And the solid reaches down
to the table top when there is one.

Source: residual and size term after Solina and Bajcsy 1990 and thesis 12.3.1; mixture after Liu et al. 2022 (EMS).
The released code behind the thesis minimises (F^e1 - 1)^2 by forward differences without any outlier model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import FloatArray
from icub_grasp_generators.superquadrics.residuals import (
    PARAMETERS,
    Solids,
    gauge_jacobian,
    outline_area,
    support_jacobian,
    viewers,
)
from icub_grasp_generators.superquadrics.shape import EXPONENT_RANGE, Superquadric
from icub_grasp_generators.superquadrics.start import MIN_POINTS, scale_of, starts, usable_sample

_COARSE_POINTS = 130
_COARSE_SIGMAS = (0.05, 0.05, 0.03, 0.03, 0.02, 0.02, 0.02)  # of the object's size, one per step
_FINE_STEPS = 14
_SIGMA_FLOOR = 0.015  # of the object's size: no real object is a superquadric to better than that
_OUTLIER_AT = 3.0  # distance, in sigmas, at which inlier and outlier are equally likely
_OUTLINE_WEIGHT = 0.5  # 1 is the likelihood itself, which ends a free edge sqrt(2) sigma inside its last points
_LAST_STEPS = 4
_LAST_OUTLINE_WEIGHT = 0.2
_END = 0.015  # share of the points beyond the place where a face is moved in to
_RETRACT_SIGMA = 0.015
_AVERTED = 0.2  # of a normal against the mean of the visible normals
_TABLE_WEIGHT = 0.3  # of the number of points
_CONVERGED = 3e-4  # step, in units of the object's size and radians
_DAMPED = 0.1  # curvature, per point, that damping adds to every direction
_LOW = np.array([-np.inf] * 3 + [np.log(0.02)] * 3 + [EXPONENT_RANGE[0]] * 2)
_HIGH = np.array([np.inf] * 3 + [np.log(2.0)] * 3 + [EXPONENT_RANGE[1]] * 2)
_DOWN = np.array([0.0, 0.0, -1.0])


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


class _Problem:
    """The cost of solids against one cloud, in the frame of the fit.

    Args:
        points: (N, 3).
        table: Height of the table, or None.
    """

    def __init__(self, points: FloatArray, table: float | None) -> None:
        self.rows = np.ascontiguousarray(points.T)
        self.count = len(points)
        self._table = table

    def terms(self, solids: Solids) -> _Terms:
        """Evaluate distances and Jacobians."""
        norm, J, slope = gauge_jacobian(solids, self.rows)
        norm -= 1.0
        norm /= slope
        J /= slope[:, None]
        if self._table is None:
            return _Terms(norm, J, None, None)
        root = np.sqrt(_TABLE_WEIGHT * self.count)
        reach, J_table = support_jacobian(solids, _DOWN)
        J_table *= -root
        J_table[:, 2] += root
        return _Terms(norm, J, root * (solids.center[:, 2] - reach - self._table), J_table)


@dataclass
class _Terms:
    """Distances r (S, N) of the points, the table's residual (S,), and Jacobians (S, 11, N), (S, 11)."""

    r: FloatArray
    J: FloatArray
    r_table: FloatArray | None
    J_table: FloatArray | None

    def replace(self, other: _Terms, index: NDArray[np.bool_]) -> None:
        """Take over the rows `index` (S,) of `other`."""
        self.r[index], self.J[index] = other.r[index], other.J[index]
        if self.r_table is not None and self.J_table is not None:
            self.r_table[index], self.J_table[index] = other.r_table[index], other.J_table[index]  # type: ignore[index]

    def view(self, w: FloatArray) -> FloatArray:
        """Return the weighted mean of the surface normals at the points (S, 3), of length 0..1.

        Its direction stands for that of the viewer, which a cloud does not carry. Normals of a single view add up to
        more than half; those of a cloud from all around cancel.
        """
        return -(self.J[:, :3] @ w[:, :, None])[..., 0] / np.maximum(w.sum(axis=1), 1.0)[:, None]

    def mixture(self, sigma: FloatArray, view: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the points' probabilities of being surface (S, N) and -sigma^2 times the log likelihood (S,)."""
        odds = self.r / sigma[:, None]
        odds *= odds
        odds -= _OUTLIER_AT**2
        odds *= -0.5
        np.exp(odds, out=odds)
        # a side that looks away was not seen: points near it are outliers, and must not pull it out to them
        odds *= (view[:, None] @ self.J[:, :3])[:, 0] < _AVERTED
        total = 1.0 + odds
        cost = -(sigma**2) * np.log(total).sum(axis=1)
        if self.r_table is not None:
            cost += 0.5 * self.r_table**2
        odds /= total
        return odds, cost


def _descend(
    problem: _Problem, solids: Solids, sigmas: tuple[float, ...], outline: float, *, estimate: bool
) -> tuple[Solids, FloatArray, FloatArray, FloatArray]:
    """Improve a batch of solids, one damped step per entry of `sigmas`.

    Args:
        problem: The cloud.
        solids: Where to start; overwritten.
        sigmas: Noise of each step, or, with `estimate`, the least noise that may be estimated.
        estimate: Estimate the noise from the weighted distances, and stop when the steps become small.

    Returns:
        The solids, their costs (S,), the points' weights (S, N), and the noise (S,).
    """
    damping = np.full(len(solids.R), 1e-2)
    sigma = np.full(len(solids.R), sigmas[0])
    terms = problem.terms(solids)
    view = np.zeros((len(sigma), 3))
    w, cost = terms.mixture(sigma, view)
    for limit in sigmas:
        if estimate:
            spread = np.sqrt(np.einsum("sn,sn,sn->s", w, terms.r, terms.r) / np.maximum(w.sum(axis=1), 1.0))
            sigma = np.maximum(np.minimum(1.1 * spread, sigma), limit)
        else:
            sigma = np.full(len(solids.R), limit)
        view = terms.view(w)
        seen = view if estimate else np.zeros_like(view)
        w, cost = terms.mixture(sigma, seen)
        weighted = terms.J * w[:, None]
        pull = (outline * problem.count) * sigma**2
        viewer = viewers(solids, view)
        area, J_area = outline_area(solids, viewer)
        step = _step(solids, terms, weighted, pull[:, None] * J_area, damping)
        trial = solids.moved(step, _LOW, _HIGH)
        trial_terms = problem.terms(trial)
        trial_w, trial_cost = trial_terms.mixture(sigma, seen)
        better = trial_cost + pull * outline_area(trial, viewer)[0] < cost + pull * area
        if better.all():
            solids, terms, w, cost = trial, trial_terms, trial_w, trial_cost
            if estimate and float(np.abs(step).max()) < _CONVERGED:
                break
        else:
            solids.R[better], solids.vector[better] = trial.R[better], trial.vector[better]
            terms.replace(trial_terms, better)
            w[better], cost[better] = trial_w[better], trial_cost[better]
        damping = np.clip(np.where(better, damping * 0.2, damping * 8.0), 1e-7, 1e3)
    return solids, cost, w, sigma


def _retract(problem: _Problem, solids: Solids, sigma: FloatArray) -> Solids:
    """Move the faces of one solid in to where its points end, where that makes the cloud more likely.

    A hidden face that has caught a few outliers is a local optimum that no small step leaves.
    """
    terms = problem.terms(solids)
    w, _ = terms.mixture(sigma, np.zeros((1, 3)))
    view = terms.view(w)
    w, _ = terms.mixture(sigma, view)
    viewer = viewers(solids, view)
    local = solids.R[0].T @ (problem.rows[:, w[0] > 0.5] - solids.center[0][:, None])
    if local.shape[1] < MIN_POINTS:
        return solids
    half = solids.half[0]
    ends = np.quantile(local, [_END, 1.0 - _END], axis=1)  # (2, 3)
    shifts = np.clip(np.stack([half + ends[0], half - ends[1]]), 0.0, 1.8 * half).ravel()  # of the six faces, inwards

    def shrunk(chosen: FloatArray) -> Solids:
        """Apply the shifts (6,) selected by the rows of `chosen` (V, 6)."""
        low, high = chosen[:, :3] * shifts[:3], chosen[:, 3:] * shifts[3:]
        vector = np.repeat(solids.vector, len(chosen), axis=0)
        vector[:, :3] += (low - high) / 2 @ solids.R[0].T
        vector[:, 3:6] = np.maximum(np.log(np.maximum(half - (low + high) / 2, 1e-3)), _LOW[3])
        return Solids(np.repeat(solids.R, len(chosen), axis=0), vector)

    def objective(variants: Solids) -> FloatArray:
        views = np.repeat(view, len(variants.R), axis=0)
        _, cost = problem.terms(variants).mixture(np.repeat(sigma, len(variants.R)), views)
        return (
            cost
            + _OUTLINE_WEIGHT
            * problem.count
            * sigma[0] ** 2
            * outline_area(variants, np.repeat(viewer, len(variants.R), axis=0))[0]
        )

    single = np.concatenate([np.zeros((1, 6)), np.eye(6)])
    costs = objective(shrunk(single))
    improving = (costs[1:] < costs[0]).astype(float)
    if not improving.any():
        return solids
    choices = np.stack([improving, single[1 + int(np.argmin(costs[1:]))]])
    return_of = shrunk(choices)
    best = int(np.argmin(objective(return_of)))
    return Solids(return_of.R[best : best + 1], return_of.vector[best : best + 1])


def _step(solids: Solids, terms: _Terms, weighted: FloatArray, g_area: FloatArray, damping: FloatArray) -> FloatArray:
    """One damped Gauss-Newton step (S, 11) that does not push parameters through their bounds."""
    H = weighted @ terms.J.transpose(0, 2, 1)
    g = (weighted @ terms.r[..., None])[..., 0]
    g += g_area
    if terms.r_table is not None and terms.J_table is not None:
        H += terms.J_table[:, :, None] * terms.J_table[:, None]
        g += terms.J_table * terms.r_table[:, None]
    bounded, slope = solids.vector[:, 3:], g[:, 6:]
    stuck = np.zeros(g.shape, dtype=bool)
    stuck[:, 6:] = ((bounded <= _LOW[3:]) & (slope > 0)) | ((bounded >= _HIGH[3:]) & (slope < 0))
    if stuck.any():
        free = (~stuck).astype(float)
        H *= free[:, :, None] * free[:, None]
        g *= free
    diagonal = H.reshape(len(H), -1)[:, :: PARAMETERS + 1]
    # damping has an absolute part too: hidden sides have no curvature of their own, only the outline's pull
    diagonal += damping[:, None] * (diagonal + _DAMPED * terms.r.shape[1]) + stuck
    return -np.linalg.solve(H, g[..., None])[..., 0]


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
    sample = usable_sample(np.asarray(points))
    origin, size = scale_of(sample)
    sample -= origin
    sample /= size
    table = None if table_top is None else (table_top - origin[2]) / size
    few = sample[:: max(1, len(sample) // _COARSE_POINTS)]
    solids, cost, _, _ = _descend(
        _Problem(few, table), starts(few, table), _COARSE_SIGMAS, _OUTLINE_WEIGHT, estimate=False
    )
    best = int(np.argmin(cost))
    problem = _Problem(sample, table)
    solids, _, w, sigma = _descend(
        problem,
        _retract(
            problem, Solids(solids.R[best : best + 1], solids.vector[best : best + 1]), np.array([_RETRACT_SIGMA])
        ),
        (_COARSE_SIGMAS[-1],) + (_SIGMA_FLOOR,) * _FINE_STEPS,
        _OUTLINE_WEIGHT,
        estimate=True,
    )
    # the pull has found the right side of every ambiguity; with less of it edges settle nearer to their last points
    noise = float(sigma[0])
    solids, _, w, sigma = _descend(problem, solids, (noise,) * _LAST_STEPS, _LAST_OUTLINE_WEIGHT, estimate=False)
    shape = Superquadric.from_parts(
        solids.half[0] * size, solids.exponents[0].copy(), solids.R[0], solids.center[0] * size + origin
    )
    distance = shape.distance(sample * size + origin)
    rms = float(np.sqrt(np.dot(w[0], distance**2) / max(float(w.sum()), 1e-9)))
    return SuperquadricFit(shape, rms, float(w.mean()), float(sigma[0]) * size)
