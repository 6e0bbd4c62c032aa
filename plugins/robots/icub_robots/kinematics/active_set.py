"""One iteration of damped least squares with joint limits, for one target and for many.

The iteration solves min |J dq - e|^2 + damping |dq - v|^2, where e is the twist to the target and v pulls towards a
posture: dq = v + J^T (J J^T + damping I)^-1 (e - J v). A joint that this would carry beyond a limit is set on it, its
motion is taken off e, and the rest is solved again.

Source: Buss, "Introduction to inverse kinematics with Jacobian transpose, pseudoinverse and damped least squares
methods", 2004, section 6; the treatment of limits follows Flacco et al., "Motion control of redundant robots under
joint constraints: saturation in the null space", ICRA 2012.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from icub_core.geometry import FloatArray
from icub_robots.kinematics.settings import DAMPING, MAX_STEP

FEW_ROWS = 4  # of a batch: from here on one by one is faster
_DAMPING = DAMPING * np.eye(6)


def step(
    J: FloatArray, error: FloatArray, q: FloatArray, pull: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Return the next q (n,), from the Jacobian (6, n), the twist (6,) to the target and the pull (n,)."""
    fixed = None
    while True:
        H = J.dot(J.T)
        H += _DAMPING
        dq = lapack.dposv(H, error - J.dot(pull))[1].dot(J)
        dq += pull
        largest = max(dq.max(), -dq.min())
        if largest > MAX_STEP:
            dq *= MAX_STEP / largest
        moved = q + dq
        limited = np.minimum(np.maximum(moved, lower), upper)
        beyond = limited != moved
        if fixed is not None:
            beyond &= ~fixed
        if not beyond.any():
            return limited
        fixed = beyond if fixed is None else fixed | beyond
        onto = limited - q
        error = error - J.dot(np.where(beyond, onto, 0.0))
        J = np.where(fixed, 0.0, J)
        pull = np.where(fixed, onto, pull)


def step_batch(
    J: FloatArray, error: FloatArray, q: FloatArray, pull: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Return the next q (B, n): `step` for every row of J (B, 6, n), error (B, 6), q and pull (B, n)."""
    result = np.empty_like(q)
    rows = np.arange(len(q))
    fixed = np.zeros(q.shape, dtype=np.bool_)
    while True:
        J_T = np.ascontiguousarray(np.swapaxes(J, 1, 2))  # halves the time of the product
        H = J @ J_T
        H += _DAMPING
        y = np.linalg.solve(H, error[..., None] - J @ pull[..., None])
        dq = (J_T @ y)[..., 0] + pull
        largest = np.abs(dq).max(axis=1, keepdims=True)
        dq *= MAX_STEP / np.maximum(largest, MAX_STEP)
        moved = q + dq
        limited = np.clip(moved, lower, upper)
        result[rows] = limited
        beyond = (limited != moved) & ~fixed
        again = beyond.any(axis=1)
        if not again.any():
            return result
        rows, q, limited = rows[again], q[again], limited[again]
        beyond, J, error, pull = beyond[again], J[again], error[again], pull[again]
        fixed = fixed[again] | beyond
        onto = limited - q
        error = error - (J @ np.where(beyond, onto, 0.0)[..., None])[..., 0]
        J = np.where(fixed[:, None, :], 0.0, J)
        pull = np.where(fixed, onto, pull)
        if len(rows) <= FEW_ROWS:  # the fixed joints are out of J and on their limits in pull: nothing is lost
            for i, row in enumerate(rows):
                result[row] = step(J[i], error[i], q[i], pull[i], lower, upper)
            return result
