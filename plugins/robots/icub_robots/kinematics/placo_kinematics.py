"""Kinematics by Placo: a quadratic program per iteration, with the shoulder's cables as constraints."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import placo

from icub_core.errors import ConfigError
from icub_core.geometry import FloatArray
from icub_core.interfaces.robot import IkSolution
from icub_robots.cables import CABLE_MATRIX, CABLE_OFFSET, shoulder
from icub_robots.kinematics.base import IkRequest, Kinematics
from icub_robots.kinematics.model import PinocchioModel
from icub_robots.kinematics.settings import AT_LIMIT, CONVERGED, MIN_PROGRESS
from icub_support.cache import cached_text

POSTURE_WEIGHT = 1e-6  # of staying near the start, against 1 of the pose; 1e-4 loses a tenth of the targets
REGULARIZATION = 1e-4  # of the step
PATIENCE = 10  # iterations without progress that end a descent


class PlacoKinematics(Kinematics):
    """Whole-body quadratic programs: pose task, posture task, joint limits, optionally cable limits.

    Args:
        model: The robot.
        lower: (n,) limits of inverse kinematics, rad.
        upper: (n,) limits of inverse kinematics, rad.
        restarts: (k, n) further starts of a solve that is not tracking and did not reach.
        cable_limits: Keep the shoulders' cables slack; see `cables`.
    """

    def __init__(
        self,
        model: PinocchioModel,
        lower: FloatArray,
        upper: FloatArray,
        restarts: FloatArray,
        cable_limits: bool,
    ) -> None:
        self._model = model
        self._lower, self._upper = lower, upper
        self._restarts = restarts
        self._cable_limits = cable_limits
        description = model.description
        self._names = description.joint_names
        urdf = _without_shapes(description.urdf.read_text(encoding="utf-8"))
        self._robot: Any = placo.RobotWrapper(str(cached_text("robots", urdf, ".urdf")), placo.Flags.ignore_collisions)
        self._robot.set_T_world_fbase(description.T_world_root)
        for name, low, high in zip(self._names, lower, upper, strict=True):
            self._robot.set_joint_limits(name, float(low), float(high))
        self._offsets = np.array([self._robot.get_joint_offset(name) for name in self._names], dtype=np.intp)
        self._solvers: dict[tuple[str, str], tuple[Any, Any, Any]] = {}

    def _solver(self, frame: str, group: str) -> tuple[Any, Any, Any]:
        """Return the solver of one frame and group, its pose task and its posture task."""
        known = self._solvers.get((frame, group))
        if known is not None:
            return known
        description = self._model.description
        description.indices(group)  # names the nearest group if there is none
        members = set(description.groups[group])
        support = self._model.support(frame)
        if not members & set(support):
            joints = ", ".join(support) or "none"
            raise ConfigError(f"no joint of group '{group}' moves '{frame}'; the joints that do: {joints}")
        solver = placo.KinematicsSolver(self._robot)
        solver.mask_fbase(True)
        for name in self._names:
            if name not in members:
                solver.mask_dof(name)
        solver.enable_joint_limits(True)
        pose = solver.add_frame_task(frame, np.eye(4))
        pose.configure(frame, "soft", 1.0, 1.0)
        posture = solver.add_joints_task()
        posture.configure("posture", "soft", POSTURE_WEIGHT)
        solver.add_regularization_task(REGULARIZATION)
        for side in ("right", "left"):
            if self._cable_limits and members >= set(shoulder(side)):
                columns, offset = self._constraint_columns()
                A = np.zeros((len(CABLE_OFFSET), columns))
                A[:, [offset(name) for name in shoulder(side)]] = -CABLE_MATRIX
                solver.add_joint_space_half_spaces_constraint(A, CABLE_OFFSET).configure(f"{side} cables", "hard", 1.0)
        self._solvers[frame, group] = solver, pose, posture
        return self._solvers[frame, group]

    def _constraint_columns(self) -> tuple[int, Callable[[str], int]]:
        """Return the width of a joint-space constraint for this version of Placo, and where its joints are."""
        q, v = len(self._robot.state.q), len(self._robot.state.qd)
        trial = placo.KinematicsSolver(self._robot)
        trial.add_regularization_task(1.0)
        trial.add_joint_space_half_spaces_constraint(np.zeros((1, q)), np.ones(1))
        try:
            trial.solve(False)
        except RuntimeError:  # newer versions count velocities
            return v, self._robot.get_joint_v_offset
        return q, self._robot.get_joint_offset

    def solve(self, target: FloatArray, q_start: FloatArray, frame: str, group: str, request: IkRequest) -> IkSolution:
        """Place `frame` at `target` (4, 4) with the joints of `group`, from `q_start` (n,)."""
        free = self._model.description.indices(group)
        self._solver(frame, group)[1].T_world_frame = target
        best = self._descend(target, q_start, q_start, frame, group, request)
        if not best.reached and not request.tracking:
            for row in self._restarts:
                other = q_start.copy()
                other[free] = row[free]
                solution = self._descend(target, other, q_start, frame, group, request)
                if solution.reached:
                    return solution
                best = min(best, solution, key=lambda s: _cost((s.position_error, s.orientation_error), request))
        return best

    def _descend(
        self, target: FloatArray, start: FloatArray, posture: FloatArray, frame: str, group: str, request: IkRequest
    ) -> IkSolution:
        solver, _, posture_task = self._solver(frame, group)
        free = self._model.description.indices(group)
        posture_task.set_joints({self._names[i]: float(posture[i]) for i in free})
        q = start.copy()
        q[free] = np.clip(q[free], self._lower[free], self._upper[free])
        self._set(q)
        best, best_cost, errors, record, waited = q, math.inf, (math.inf, math.inf), math.inf, 0
        for iteration in range(request.max_iterations + 1):
            now = _errors(self._robot.get_T_world_frame(frame), target)
            cost = _cost(now, request)
            if cost < best_cost:
                best, best_cost, errors = q, cost, now
            record, waited = (cost, 0) if cost < MIN_PROGRESS * record else (record, waited + 1)
            if cost <= CONVERGED**2 or waited > PATIENCE or iteration == request.max_iterations:
                break
            try:
                solver.solve(True)
            except RuntimeError:  # the program has no solution: the start violates a constraint too far to repair
                break
            q = q.copy()
            solved = self._robot.state.q[self._offsets]
            q[free] = np.clip(solved[free], self._lower[free], self._upper[free])
            self._set(q)
        reached = errors[0] <= request.position_tolerance and errors[1] <= request.orientation_tolerance
        on_limit = (best - self._lower <= AT_LIMIT) | (self._upper - best <= AT_LIMIT)
        return IkSolution(best, reached, *errors, tuple(self._names[i] for i in free if on_limit[i]))

    def _set(self, q: FloatArray) -> None:
        full = self._robot.state.q
        full[self._offsets] = q
        self._robot.state.q = full
        self._robot.update_kinematics()


def _cost(errors: tuple[float, float], request: IkRequest) -> float:
    """Return 1 or less where both errors are within tolerance."""
    return max(errors[0] / request.position_tolerance, errors[1] / request.orientation_tolerance) ** 2


def _errors(T: FloatArray, target: FloatArray) -> tuple[float, float]:
    """Return the distance, meters, and the angle, rad, between two poses."""
    turn = pin.log3(target[:3, :3] @ T[:3, :3].T)
    return float(np.linalg.norm(target[:3, 3] - T[:3, 3])), float(np.linalg.norm(turn))


def _without_shapes(urdf: str) -> str:
    """Drop all shapes: Placo reads every mesh, which takes a second."""
    root = ET.fromstring(urdf)
    for link in root.findall("link"):
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                link.remove(element)
    return ET.tostring(root, encoding="unicode")
