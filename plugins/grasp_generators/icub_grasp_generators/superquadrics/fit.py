"""Robust fit of one superquadric to the visible side of an object.

Eleven unknowns: center, rotation, log half axes, two exponents. The residual of a point is its signed distance to the
tangent plane at the point's radial projection, r = (G - 1) / |grad G| (see `Superquadric.distance`), in which |grad G|
is held fixed during one Gauss-Newton step, so that the Jacobian of G alone, which is exact and cheap, is needed.
Outliers: every point is an inlier with normal noise sigma or belongs to a uniform background; expectation gives its
weight, maximization is one damped least-squares step. Points on a surface do not say where it ends: a box grown on its
hidden side still contains the visible ones. But a camera spreads its points evenly over the outline, so the likelihood
falls with the outline's area, which ends the solid about one sigma behind the last point. And the solid reaches down
to the table top when there is one.

Source: residual and size term after Solina and Bajcsy 1990 and thesis 12.3.1; mixture after Liu et al. 2022 (EMS).
The released code behind the thesis minimizes (F^e1 - 1)^2 by forward differences without any outlier model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from icub_core.geometry import FloatArray
from icub_grasp_generators.superquadrics.residuals import (
    PARAMETERS,
    Solids,
    columns,
    evaluate,
    outline,
    outline_jacobian,
    viewers,
)
from icub_grasp_generators.superquadrics.shape import EXPONENT_RANGE, Superquadric
from icub_grasp_generators.superquadrics.start import scale_of, starts, usable_sample


@dataclass(frozen=True)
class _Step:
    """What one step assumes: noise, of the object's size, and weight of the outline's area in the likelihood.

    A weight of 1 is the likelihood itself, which ends a free edge sqrt(2) sigma inside its last points.
    """

    sigma: float
    outline: float


_MIN_PULL = 0.012  # noise, of the size, below which the pull on the outline falls no further
_COARSE_POINTS = 125
_KEPT = 2  # starts that go on after the first steps
_FIRST = tuple(_Step(sigma, 0.5) for sigma in (0.05, 0.04, 0.03, 0.02))
_SECOND = tuple(_Step(sigma, 0.5) for sigma in (0.02, 0.02))
# No real object is a superquadric to better than 1.5 %. The pull on the outline finds the right side of every
# ambiguity; with less of it edges settle nearer to their last points.
_LAST = (_Step(0.015, 0.5),) * 10 + (_Step(0.015, 0.2),) * 2
_OUTLIER_AT = 3.0  # distance, in sigmas, at which inlier and outlier are equally likely
_ONE_SIDED = 0.4  # length of the mean visible normal above which a cloud is a single view
_AVERTED = 0.2  # of a normal against the mean of the visible normals
_TABLE_WEIGHT = 0.3  # of the number of points
_CONVERGED = 6e-3  # step, in units of the object's size and radians
_CAUTION = 1.1  # by which the noise is taken to be larger than estimated: weights cut the tails off
_DAMPED = 0.1  # curvature, per point, that damping adds to every direction
_LOW = np.array([-np.inf] * 3 + [np.log(0.02)] * 3 + [EXPONENT_RANGE[0]] * 2)
_HIGH = np.array([np.inf] * 3 + [np.log(2.0)] * 3 + [EXPONENT_RANGE[1]] * 2)
_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class SuperquadricFit:
    """A fitted superquadric and how well it explains the cloud.

    Attributes:
        shape: The superquadric, in the cloud's frame.
        rms: Root mean square distance of the inliers to the surface, meters.
        inliers: Share of the points that the fit takes for surface, 0..1.
    """

    shape: Superquadric
    rms: float
    inliers: float


class _Problem:
    """The cost of solids against one cloud, in the frame of the fit.

    Args:
        points: (N, 3).
        table: Height of the table, or None.
    """

    def __init__(self, points: FloatArray, table: float | None) -> None:
        self.rows = columns(points, None if table is None else _DOWN)
        self.count = len(points)
        self._table = table

    def terms(self, solids: Solids) -> _Terms:
        """Evaluate distances and Jacobians."""
        values = evaluate(solids, self.rows, self._table is not None)
        r = (values.gauge - 1.0) / values.slope
        if self._table is None or values.reach is None or values.J_reach is None:
            return _Terms(r, values.J_gauge, values.slope, None, None)
        root = np.sqrt(_TABLE_WEIGHT * self.count)
        J_table = -root * values.J_reach
        J_table[:, 2] += root
        r_table = root * (solids.center[:, 2] - values.reach - self._table)
        return _Terms(r, values.J_gauge, values.slope, r_table, J_table)


@dataclass
class _Terms:
    """Distances r (S, N) of the points and the table's residual (S,), with Jacobians (S, 11, N), (S, 11).

    J is that of the gauge; the distances' is J / slope, with slope (S, N) the length of the gauge's gradient. Nobody
    needs the quotient itself, which is the largest array here.
    """

    r: FloatArray
    J: FloatArray
    slope: FloatArray
    r_table: FloatArray | None
    J_table: FloatArray | None

    def take(self, index: NDArray[np.intp]) -> _Terms:
        """Return the terms of the solids with these numbers."""
        if self.r_table is None or self.J_table is None:
            return _Terms(self.r[index], self.J[index], self.slope[index], None, None)
        return _Terms(self.r[index], self.J[index], self.slope[index], self.r_table[index], self.J_table[index])

    def replace(self, other: _Terms, index: NDArray[np.bool_]) -> None:
        """Take over the rows `index` (S,) of `other`."""
        self.r[index], self.J[index], self.slope[index] = other.r[index], other.J[index], other.slope[index]
        if self.r_table is not None and other.r_table is not None:
            self.r_table[index] = other.r_table[index]
        if self.J_table is not None and other.J_table is not None:
            self.J_table[index] = other.J_table[index]

    def view(self, w: FloatArray) -> FloatArray:
        """Return the weighted mean of the surface normals at the points (S, 3), of length 0..1.

        Its direction stands for that of the viewer, which a cloud does not carry. Normals of a single view add up to
        more than half; those of a cloud from all around cancel.
        """
        return -(self.J[:, :3] @ (w / self.slope)[:, :, None])[..., 0] / np.maximum(w.sum(axis=1), 1.0)[:, None]

    def deviation(self, w: FloatArray) -> FloatArray:
        """Return the weighted root mean square of the distances (S,)."""
        square: FloatArray = np.einsum("sn,sn->s", w * self.r, self.r)
        return np.sqrt(square / np.maximum(w.sum(axis=1), 1.0))

    def odds(self, sigma: FloatArray) -> FloatArray:
        """Return how much likelier each point is surface, with noise sigma (S,), than background: (S, N)."""
        odds = self.r / sigma[:, None]
        odds *= odds
        odds -= _OUTLIER_AT**2
        odds *= -0.5
        return np.exp(odds, out=odds)

    def mixture(self, odds: FloatArray, sigma: FloatArray, view: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Return the points' probabilities of being surface (S, N) and -sigma^2 times the log likelihood (S,)."""
        if view is not None:
            # a side that looks away was not seen: points near it are outliers, and must not pull it out to them
            odds = odds * ((view[:, None] @ self.J[:, :3])[:, 0] < _AVERTED * self.slope)
        total = 1.0 + odds
        w = odds / total
        cost = -(sigma**2) * np.log(total, out=total).sum(axis=1)
        if self.r_table is not None:
            cost += 0.5 * self.r_table**2
        return w, cost


@dataclass(frozen=True)
class _Descended:
    """Where a descent ended: solids, their terms, costs (S,) and the points' probabilities of being surface (S, N)."""

    solids: Solids
    terms: _Terms
    cost: FloatArray
    w: FloatArray


def _descend(
    problem: _Problem, solids: Solids, steps: Sequence[_Step], *, estimate: bool, terms: _Terms | None = None
) -> _Descended:
    """Improve a batch of solids by damped Gauss-Newton steps.

    Args:
        problem: The cloud.
        solids: Where to start.
        steps: What each step assumes.
        estimate: Estimate the noise from the weighted distances (the steps' noise is then the least that is believed),
            leave sides that look away out of account, and skip steps of a kind once they have become small.
        terms: Those of `solids`, where they are known; overwritten.
    """
    damping = np.full(len(solids.R), 1e-2)
    sigma = spread = np.full(len(solids.R), steps[0].sigma)
    if terms is None:
        terms = problem.terms(solids)
    odds = terms.odds(sigma)
    seen: FloatArray | None = None
    w, cost = terms.mixture(odds, sigma, seen)
    converged: _Step | None = None
    for kind in steps:
        if kind is converged:
            continue
        # a side that was wrongly taken to look away must be able to come back: its points count for the view
        view = terms.view(odds / (1.0 + odds) if seen is not None else w)
        if estimate:
            spread = _CAUTION * terms.deviation(w)
            believed = np.maximum(np.minimum(spread, sigma), kind.sigma)
            if np.any(believed != sigma):
                sigma, odds = believed, terms.odds(believed)
            seen = view if float(view[0] @ view[0]) > _ONE_SIDED**2 else None
            w, cost = terms.mixture(odds, sigma, seen)
        elif sigma[0] != kind.sigma:
            spread = sigma = np.full(len(solids.R), kind.sigma)
            odds = terms.odds(sigma)
            w, cost = terms.mixture(odds, sigma, None)
        viewer = viewers(solids, view)
        pull = (kind.outline * problem.count) * np.maximum(spread, _MIN_PULL) ** 2
        step = _solve(solids, terms, w, pull[:, None] * outline_jacobian(solids, viewer), damping)
        trial = solids.moved(step, _LOW, _HIGH)
        trial_terms = problem.terms(trial)
        trial_odds = trial_terms.odds(sigma)
        trial_w, trial_cost = trial_terms.mixture(trial_odds, sigma, seen)
        better = trial_cost + pull * (outline(trial, viewer) - outline(solids, viewer)) < cost
        if better.all():
            solids, terms, odds, w, cost = trial, trial_terms, trial_odds, trial_w, trial_cost
            damping = np.maximum(damping * 0.2, 1e-7)
        else:
            solids = trial.where(better, solids)
            terms.replace(trial_terms, better)
            odds[better], w[better], cost[better] = trial_odds[better], trial_w[better], trial_cost[better]
            damping = np.where(better, damping * 0.2, np.minimum(damping * 8.0, 1e3))
        # |grad G| is held fixed during a step, so near the minimum a step need not descend: refusals end there too
        if estimate and (not better[0] or float(np.abs(step).max()) < _CONVERGED):
            converged = kind
    return _Descended(solids, terms, cost, w)


def _solve(solids: Solids, terms: _Terms, w: FloatArray, area_slope: FloatArray, damping: FloatArray) -> FloatArray:
    """One damped Gauss-Newton step (S, 11) that does not push parameters through their bounds."""
    w = w / terms.slope
    g = (terms.J @ (w * terms.r)[..., None])[..., 0]
    g += area_slope
    w /= terms.slope
    H = (terms.J * w[:, None]) @ terms.J.transpose(0, 2, 1)
    if terms.r_table is not None and terms.J_table is not None:
        H += terms.J_table[:, :, None] * terms.J_table[:, None]
        g += terms.J_table * terms.r_table[:, None]
    bounded, slope = solids.vector[:, 3:], g[:, 6:]
    stuck = ((bounded <= _LOW[3:]) & (slope > 0)) | ((bounded >= _HIGH[3:]) & (slope < 0))
    diagonal = H.reshape(len(H), -1)[:, :: PARAMETERS + 1]
    # damping has an absolute part too: hidden sides have no curvature of their own, only the outline's pull
    diagonal += damping[:, None] * (diagonal + _DAMPED * terms.r.shape[1])
    if stuck.any():
        for solid, parameter in zip(*np.nonzero(stuck), strict=True):
            H[solid, 6 + parameter] = 0.0
            H[solid, :, 6 + parameter] = 0.0
            H[solid, 6 + parameter, 6 + parameter] = 1.0
            g[solid, 6 + parameter] = 0.0
    # Cholesky one by one: numpy's batched LU costs more than all of them
    return -np.array([lapack.dposv(H_s, g_s)[1] for H_s, g_s in zip(H, g, strict=True)])


def fit_superquadric(points: NDArray[np.floating], table_top: float | None = None) -> SuperquadricFit:
    """Fit a superquadric to surface points of one object, seen from one side or from all.

    Args:
        points: (N, 3) meters; the third axis points up when `table_top` is given.
        table_top: Height of the table on which the object stands, meters. The solid then reaches down to it, and the
            starts have an upright axis. None for an object in the air.

    Returns:
        The fit; the same points give the same fit.

    Raises:
        DataError: The cloud has fewer than 20 points, is not finite, spans more than a meter, or lies on a line.
    """
    sample = usable_sample(np.asarray(points))
    origin, size = scale_of(sample)
    sample -= origin
    sample /= size
    table = None if table_top is None else (table_top - origin[2]) / size
    few = sample[:: max(1, round(len(sample) / _COARSE_POINTS))]
    coarse = _Problem(few, table)
    found = _descend(coarse, starts(few, table), _FIRST, estimate=False)
    best = np.argsort(found.cost, kind="stable")[:_KEPT]
    found = _descend(coarse, found.solids.take(best), _SECOND, estimate=False, terms=found.terms.take(best))
    solids = found.solids.take(np.argmin(found.cost, keepdims=True))
    found = _descend(_Problem(sample, table), solids, _LAST, estimate=True)
    solids, deviation = found.solids, found.terms.deviation(found.w)
    shape = Superquadric.from_parts(
        solids.half[0] * size, solids.exponents[0].copy(), solids.R[0], solids.center[0] * size + origin
    )
    return SuperquadricFit(shape, float(deviation[0]) * size, float(found.w.mean()))
