"""Inverse kinematics of many targets at once: the solver of `damped_least_squares`, vectorized over the targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from icub_core.geometry import FloatArray
from icub_robots.kinematics.active_set import step_batch
from icub_robots.kinematics.base import IkRequest
from icub_robots.kinematics.settings import (
    CONVERGED,
    MIN_PROGRESS,
    PATIENCE,
    POSTURE_DECAY,
    POSTURE_GAIN,
)

_YZX, _ZXY = [1, 2, 0], [2, 0, 1]
FEW = 10  # targets left: from here on the scalar solver is faster


class ChainGeometry:
    """Forward kinematics of a serial chain of revolute joints for B joint vectors at once.

    Args:
        model: Pinocchio model with the chain's joints only, each the parent of the next.
        frame: Pinocchio's number of the link at the end.
    """

    def __init__(self, model: Any, frame: int) -> None:
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        n = model.nq
        self._axes = np.empty((n, 1, 3, 1))
        # Rodrigues: placement * rotation(q) = (R0 (I + K^2), p0) + sin q (R0 K, 0) - cos q (R0 K^2, 0)
        terms = np.zeros((n, 3, 4, 4))
        for i in range(n):
            axis = pin.getJointJacobian(model, data, i + 1, pin.ReferenceFrame.LOCAL)[3:, i]
            K = pin.skew(axis)
            placement = model.jointPlacements[i + 1]
            self._axes[i, 0, :, 0] = axis
            terms[i, 0] = placement.homogeneous
            terms[i, 0, :3, :3] += placement.rotation @ K @ K
            terms[i, 1, :3, :3] = placement.rotation @ K
            terms[i, 2, :3, :3] = -placement.rotation @ K @ K
        self._terms = terms.reshape(n, 3, 16)
        self._end = np.array(model.frames[frame].placement.homogeneous)

    def __call__(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return, for q (B, n): T_world_frame (B, 4, 4), joint axes and origins (n, B, 3), world."""
        factors = np.ones((*q.T.shape, 3))
        factors[..., 1], factors[..., 2] = np.sin(q.T), np.cos(q.T)
        T = (factors @ self._terms).reshape(*q.T.shape, 4, 4)
        for i in range(1, len(T)):
            T[i] = np.matmul(T[i - 1], T[i])
        axes = (T[..., :3, :3] @ self._axes)[..., 0]
        return T[-1] @ self._end, axes, T[..., :3, 3]


def rotation_vectors(R: FloatArray) -> FloatArray:
    """Return the rotation vectors (B, 3) of rotations (B, 3, 3); at half a turn the axis is any that fits."""
    v = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.sqrt(np.einsum("bi,bi->b", v, v))
    cosine = 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    small = sine < 1e-8
    scaled = v * (angle / np.where(small, 1.0, sine))[:, None]
    if small.any():
        scaled[small] = v[small]
        half_turn = np.flatnonzero(small & (cosine < 0))
        # R = 2 a a^T - I there: the largest column of R + I is along the axis
        for b in half_turn:
            columns = R[b] + np.eye(3)
            axis = columns[:, int(np.argmax(np.diagonal(columns)))]
            scaled[b] = np.pi * axis / np.linalg.norm(axis)
    return scaled


@dataclass
class Descents:
    """Where B descents from one start ended.

    Attributes:
        q: (B, n) best joint positions.
        errors: (B, 2) position error, meters, and orientation error, rad, at q.
        unfinished: Rows whose descent is not over; at most FEW unless the iterations ran out.
        gain: Posture gain that their next iteration would take.
    """

    q: FloatArray
    errors: FloatArray
    unfinished: NDArray[np.intp]
    gain: float = POSTURE_GAIN


def descend(
    geometry: ChainGeometry,
    targets: FloatArray,
    start: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    free: NDArray[np.bool_],
    request: IkRequest,
) -> Descents:
    """Run one descent per target.

    Args:
        geometry: The chain.
        targets: (B, 4, 4) wanted poses, world.
        start: (n,) where all begin, within the limits; also the posture to stay near.
        lower: (n,) limits, rad.
        upper: (n,) limits, rad.
        free: (n,) joints that may move.
        request: Iterations and tolerances.
    """
    B = len(targets)
    tolerances = np.array([request.position_tolerance, request.orientation_tolerance])
    result = Descents(np.tile(start, (B, 1)), np.full((B, 2), np.inf), np.arange(B))
    best_cost, record = np.full((2, B), np.inf)
    waited = np.zeros(B, dtype=np.intp)
    rows, q = result.unfinished, result.q.copy()
    for iteration in range(request.max_iterations + 1):
        T, axes, origins = geometry(q)
        error, errors = _errors(T, targets[rows])
        cost = np.max((errors / tolerances) ** 2, axis=1)
        better = cost < best_cost[rows]
        improved = rows[better]
        result.q[improved], result.errors[improved], best_cost[improved] = q[better], errors[better], cost[better]
        progress = cost < MIN_PROGRESS * record[rows]
        record[rows] = np.where(progress, cost, record[rows])
        waited[rows] = np.where(progress, 0, waited[rows] + 1)
        going = (cost > CONVERGED**2) & (waited[rows] <= PATIENCE)
        if not going.all():
            rows, q, T, error = rows[going], q[going], T[going], error[going]
            axes, origins = axes[:, going], origins[:, going]
        if iteration == request.max_iterations or len(rows) <= FEW:
            break
        J = _jacobians(T[:, :3, 3], axes, origins)
        if not free.all():
            J *= free
        q = step_batch(J, error, q, result.gain * (start - q), lower, upper)
        result.gain *= POSTURE_DECAY
    result.unfinished = rows
    return result


def _errors(T: FloatArray, targets: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the twists (B, 6) that carry T (B, 4, 4) to the targets in unit time, and the plain errors (B, 2).

    Linear velocity first, world axes, at T's origin: v = V(w)^-1 t with the rotation vector w and the offset t, where
    V^-1 t = t - w x t / 2 + (1 - |w|/2 cot(|w|/2)) / |w|^2 w x (w x t).
    """
    t = targets[:, :3, 3] - T[:, :3, 3]
    w = rotation_vectors(targets[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2))
    errors = np.sqrt(np.stack([np.einsum("bi,bi->b", t, t), np.einsum("bi,bi->b", w, w)], axis=1))
    angle = np.maximum(errors[:, 1], 1e-4)  # below, the factor is 1/12 to more digits than the quotient has
    factor = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    w_t = _cross(w, t)
    v = t - 0.5 * w_t + factor[:, None] * _cross(w, w_t)
    return np.concatenate([v, w], axis=1), errors


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product of (B, 3) rows; numpy's own is slower at this size."""
    return a[:, _YZX] * b[:, _ZXY] - a[:, _ZXY] * b[:, _YZX]


def _jacobians(p: FloatArray, axes: FloatArray, origins: FloatArray) -> FloatArray:
    """Return (B, 6, n): linear, then angular, world axes, at the points p (B, 3)."""
    x, y, z = np.moveaxis(axes, -1, 0)
    a, b, c = np.moveaxis(p - origins, -1, 0)
    J = np.empty((6, *x.shape))
    J[0], J[1], J[2] = y * c - z * b, z * a - x * c, x * b - y * a
    J[3], J[4], J[5] = x, y, z
    return np.ascontiguousarray(J.transpose(2, 0, 1))
