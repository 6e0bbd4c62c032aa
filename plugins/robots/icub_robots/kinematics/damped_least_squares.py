"""Inverse kinematics of one chain: damped least squares with an active set on the joint limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg import lapack

from icub_core.errors import ConfigError
from icub_core.interfaces.robot import IkSolution
from icub_robots.kinematics.model import PinocchioModel

FloatArray = NDArray[np.float64]

DAMPING = 1e-4  # added to the diagonal of J J^T
MAX_STEP = 0.7  # rad, of any joint in one iteration: the linearisation is worth little beyond
POSTURE_GAIN = 0.1  # share of the way back to the reference posture taken per iteration in the null space
CONVERGED = 0.1  # an iteration within this share of both tolerances ends the descent
TRACKING_ITERATIONS = 10  # a descent allowed no more than this follows a moving target: no restarts
PATIENCE = 6  # iterations without progress that end a descent
MIN_PROGRESS = 0.98  # ratio of squared errors that counts as progress
AT_LIMIT = 1e-9  # rad


class ChainIk:
    """Solver for one frame and the joints of one group that move it.

    Each iteration solves min |J dq - e|^2 + damping |dq - v|^2, where e is the twist from the frame to its target in the
    frame's own axes and v pulls towards the reference posture: dq = v + J^T (J J^T + damping I)^-1 (e - J v). A joint
    that this would carry beyond a limit is set on it, its motion is taken off e, and the rest is solved again.

    Source: Buss, "Introduction to inverse kinematics with Jacobian transpose, pseudoinverse and damped least squares
    methods", 2004, section 6; the treatment of limits follows Flacco et al., "Motion control of redundant robots under
    joint constraints: saturation in the null space", ICRA 2012.
    """

    def __init__(self, model: PinocchioModel, frame: str, group: str, lower: FloatArray, upper: FloatArray) -> None:
        description = model.description
        members = description.groups[group] if group in description.groups else ()
        description.indices(group)  # names the nearest group if there is none
        support = model.support(frame)
        if not set(members) & set(support):
            raise ConfigError(f"no joint of group '{group}' moves '{frame}'; its joints are {', '.join(support) or 'none'}")
        locked = [model.model.getJointId(name) for name in description.joint_names if name not in support]
        self._model: Any = pin.buildReducedModel(model.model, locked, pin.neutral(model.model))
        self._data = self._model.createData()
        self._frame = self._model.getFrameId(frame, pin.FrameType.BODY)
        names = list(self._model.names[1:])
        self.joint_names = tuple(names)
        position = {name: i for i, name in enumerate(description.joint_names)}
        self._index = np.array([position[name] for name in names], dtype=np.intp)  # chain joint -> description
        self._free = np.array([name in members for name in names])
        self._all_free = bool(self._free.all())
        self._lower, self._upper = lower[self._index].copy(), upper[self._index].copy()
        self._damping = DAMPING * np.eye(6)

    def solve(
        self,
        T_world_frame: FloatArray,
        q_start: FloatArray,
        max_iterations: int,
        position_tolerance: float,
        orientation_tolerance: float,
        restarts: FloatArray | None = None,
    ) -> IkSolution:
        """Solve from `q_start` (n,), then from each row of `restarts` (k, n) until one reaches."""
        target = pin.SE3(T_world_frame)
        start = q_start[self._index]
        lower, upper = self._lower, self._upper
        if not self._all_free:  # joints that stay may stand anywhere
            lower, upper = np.where(self._free, lower, start), np.where(self._free, upper, start)
        reference = np.minimum(np.maximum(start, lower), upper)
        q, cost = self._descend(target, reference, reference, lower, upper, max_iterations, position_tolerance, orientation_tolerance)
        if restarts is not None and cost > 1.0:
            for row in restarts:
                other = np.minimum(np.maximum(row[self._index], lower), upper)
                q_other, cost_other = self._descend(
                    target, other, reference, lower, upper, max_iterations, position_tolerance, orientation_tolerance
                )
                if cost_other < cost:
                    q, cost = q_other, cost_other
                if cost <= 1.0:
                    break
        return self._answer(target, q, q_start, lower, upper, position_tolerance, orientation_tolerance)

    def _answer(
        self,
        target: Any,
        q: FloatArray,
        q_start: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        position_tolerance: float,
        orientation_tolerance: float,
    ) -> IkSolution:
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q)
        gap = pin.updateFramePlacement(model, data, self._frame).actInv(target)
        x, y, z = gap.translation.tolist()
        position_error = math.sqrt(x * x + y * y + z * z)
        x, y, z = pin.log3(gap.rotation).tolist()
        orientation_error = math.sqrt(x * x + y * y + z * z)
        full = q_start.copy()
        full[self._index] = q
        on_limit = (q - lower <= AT_LIMIT) | (upper - q <= AT_LIMIT)
        hit: tuple[str, ...] = ()
        if on_limit.any():
            hit = tuple(n for n, on, free in zip(self.joint_names, on_limit, self._free, strict=True) if on and free)
        reached = position_error <= position_tolerance and orientation_error <= orientation_tolerance
        return IkSolution(full, reached, position_error, orientation_error, hit)

    def _descend(
        self,
        target: Any,
        q: FloatArray,
        reference: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        max_iterations: int,
        position_tolerance: float,
        orientation_tolerance: float,
    ) -> tuple[FloatArray, float]:
        """Return the best q of one descent and its cost: 1 or less where both errors are within tolerance."""
        model, data, frame, damping = self._model, self._data, self._frame, self._damping
        w_position, w_orientation = position_tolerance**-2, orientation_tolerance**-2
        converged = CONVERGED**2
        best_q, best_cost, record, waited = q, math.inf, math.inf, 0
        for iteration in range(max_iterations + 1):
            pin.computeJointJacobians(model, data, q)
            placement = pin.updateFramePlacement(model, data, frame)
            error = pin.log6(placement.actInv(target)).vector
            a, b, c, d, e, f = error.tolist()
            cost = max((a * a + b * b + c * c) * w_position, (d * d + e * e + f * f) * w_orientation)
            if cost < best_cost:
                best_q, best_cost = q, cost
            if cost <= converged or iteration == max_iterations:
                break
            if cost < MIN_PROGRESS * record:
                record, waited = cost, 0
            else:
                waited += 1
                if waited > PATIENCE:
                    break
            J = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL)
            if not self._all_free:
                J = J * self._free
            q = self._step(J, error, q, reference, lower, upper, damping)
        return best_q, best_cost

    @staticmethod
    def _step(
        J: FloatArray,
        error: FloatArray,
        q: FloatArray,
        reference: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        damping: FloatArray,
    ) -> FloatArray:
        pull = POSTURE_GAIN * (reference - q)
        fixed = None
        while True:
            H = J.dot(J.T)
            H += damping
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
            # joints that meet a limit go onto it; what that contributes is taken off, the others solve for the rest
            error = error - J.dot(np.where(beyond, limited - q, 0.0))
            J = np.where(fixed, 0.0, J)
            pull = np.where(fixed, limited - q, pull)
