"""Inverse kinematics of one chain: damped least squares with an active set on the joint limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from icub_core.errors import ConfigError
from icub_core.geometry import FloatArray
from icub_core.interfaces.robot import IkSolution
from icub_robots.kinematics.active_set import step
from icub_robots.kinematics.base import IkRequest
from icub_robots.kinematics.batch import ChainGeometry, descend
from icub_robots.kinematics.model import PinocchioModel
from icub_robots.kinematics.settings import (
    AT_LIMIT,
    CONVERGED,
    MIN_PROGRESS,
    PATIENCE,
    POSTURE_DECAY,
    POSTURE_GAIN,
)


class ChainIk:
    """Solver for one frame and the joints of one group that move it.

    Descends by the iteration of `active_set`, with the twist from the frame to its target in the frame's own axes, and
    a pull towards the start posture that fades.

    Args:
        model: The whole robot.
        frame: Link to place.
        group: Joints that may move; those that do not move the frame are left alone.
        lower: (n,) limits of all joints, rad.
        upper: (n,) limits of all joints, rad.
    """

    def __init__(self, model: PinocchioModel, frame: str, group: str, lower: FloatArray, upper: FloatArray) -> None:
        description = model.description
        description.indices(group)  # names the nearest group if there is none
        members = set(description.groups[group])
        support = model.support(frame)
        if not members & set(support):
            joints = ", ".join(support) or "none"
            raise ConfigError(f"no joint of group '{group}' moves '{frame}'; the joints that do: {joints}")
        locked = [model.model.getJointId(name) for name in description.joint_names if name not in support]
        self._model: Any = pin.buildReducedModel(model.model, locked, pin.neutral(model.model))
        self._data = self._model.createData()
        self._frame = self._model.getFrameId(frame, pin.FrameType.BODY)
        self._names = tuple(self._model.names[1:])
        position = {name: i for i, name in enumerate(description.joint_names)}
        self._index = np.array([position[name] for name in self._names], dtype=np.intp)  # chain joint -> description
        self._free = np.array([name in members for name in self._names])
        self._all_free = bool(self._free.all())
        self._lower, self._upper = lower[self._index], upper[self._index]
        self._geometry = ChainGeometry(self._model, self._frame)

    def solve(
        self, target: FloatArray, q_start: FloatArray, request: IkRequest, restarts: FloatArray | None = None
    ) -> IkSolution:
        """Solve from `q_start` (n,), then from each row of `restarts` (k, n) until one reaches."""
        pose = pin.SE3(target)
        start, lower, upper = self._start(q_start)
        q, cost = self._descend(pose, start, start, lower, upper, request, POSTURE_GAIN)
        if restarts is not None and cost > 1.0:
            for row in restarts:
                other = np.minimum(np.maximum(row[self._index], lower), upper)
                q_other, cost_other = self._descend(pose, other, start, lower, upper, request, POSTURE_GAIN)
                if cost_other < cost:
                    q, cost = q_other, cost_other
                if cost <= 1.0:
                    break
        return self._answer(pose, q, q_start, lower, upper, request)

    def solve_batch(self, targets: FloatArray, q_start: FloatArray, request: IkRequest) -> list[IkSolution]:
        """Solve every target (k, 4, 4) by one descent from `q_start` (n,)."""
        start, lower, upper = self._start(q_start)
        ends = descend(self._geometry, targets, start, lower, upper, self._free, request)
        full = np.tile(q_start, (len(targets), 1))
        full[:, self._index] = ends.q
        on_limit: NDArray[np.bool_] = ((ends.q - lower <= AT_LIMIT) | (upper - ends.q <= AT_LIMIT)) & self._free
        tolerances = np.array([request.position_tolerance, request.orientation_tolerance])
        reached = np.all(ends.errors <= tolerances, axis=1).tolist()
        errors, some_limit = ends.errors.tolist(), np.any(on_limit, axis=1).tolist()
        solutions = [
            IkSolution(row, ok, error[0], error[1], self._hit(on) if any_on else ())
            for row, ok, error, on, any_on in zip(full, reached, errors, on_limit, some_limit, strict=True)
        ]
        for i in ends.unfinished:  # a few stragglers are cheaper one by one
            pose = pin.SE3(targets[i])
            q, _ = self._descend(pose, ends.q[i], start, lower, upper, request, ends.gain)
            solutions[i] = self._answer(pose, q, q_start, lower, upper, request)
        return solutions

    def _hit(self, on_limit: NDArray[np.bool_]) -> tuple[str, ...]:
        return tuple(name for name, on in zip(self._names, on_limit, strict=True) if on)

    def _start(self, q_start: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the chain's start within the limits, and the limits, closed around the joints that stay."""
        start = q_start[self._index]
        lower, upper = self._lower, self._upper
        if not self._all_free:  # joints that stay may stand anywhere
            lower, upper = np.where(self._free, lower, start), np.where(self._free, upper, start)
        return np.minimum(np.maximum(start, lower), upper), lower, upper

    def _answer(
        self,
        target: Any,
        q: FloatArray,
        q_start: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        request: IkRequest,
    ) -> IkSolution:
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q)
        gap = pin.updateFramePlacement(model, data, self._frame).actInv(target)
        position_error = _norm(gap.translation)
        orientation_error = _norm(pin.log3(gap.rotation))
        full = q_start.copy()
        full[self._index] = q
        on_limit = ((q - lower <= AT_LIMIT) | (upper - q <= AT_LIMIT)) & self._free
        hit = self._hit(on_limit) if on_limit.any() else ()
        reached = position_error <= request.position_tolerance and orientation_error <= request.orientation_tolerance
        return IkSolution(full, reached, position_error, orientation_error, hit)

    def _descend(
        self,
        target: Any,
        q: FloatArray,
        reference: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        request: IkRequest,
        gain: float,
    ) -> tuple[FloatArray, float]:
        """Return the best q of one descent and its cost: 1 or less where both errors are within tolerance."""
        model, data, frame = self._model, self._data, self._frame
        w_position, w_orientation = request.position_tolerance**-2, request.orientation_tolerance**-2
        converged, last = CONVERGED**2, request.max_iterations
        best_q, best_cost, record, waited = q, math.inf, math.inf, 0
        for iteration in range(last + 1):
            pin.computeJointJacobians(model, data, q)
            placement = pin.updateFramePlacement(model, data, frame)
            error = pin.log6(placement.actInv(target)).vector
            a, b, c, d, e, f = error.tolist()
            cost = max((a * a + b * b + c * c) * w_position, (d * d + e * e + f * f) * w_orientation)
            if cost < best_cost:
                best_q, best_cost = q, cost
            if cost <= converged or iteration == last:
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
            q = step(J, error, q, gain * (reference - q), lower, upper)
            gain *= POSTURE_DECAY
        return best_q, best_cost


def _norm(vector: FloatArray) -> float:
    x, y, z = vector.tolist()
    return math.sqrt(x * x + y * y + z * z)
