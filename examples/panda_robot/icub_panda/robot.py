"""The plugin: a description, and kinematics by Pinocchio in a few lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from icub_core.errors import ConfigError, unknown_name
from icub_core.interfaces.robot import IkSolution, Robot
from icub_core.robot_description import RobotDescription
from icub_panda.description import describe

FloatArray = NDArray[np.float64]

_DAMPING = 1e-4 * np.eye(6)
_MAX_STEP = 0.5  # rad of any joint in one iteration
_HOMEWARD = 0.2  # share of the way back to the start's posture that an iteration takes in the null space
_RESTARTS = 4
_FOLLOWS = 10  # iterations up to which a solve only follows from its start, without restarts


class Panda(Robot):
    """Franka's Panda (seven joints, a gripper of two fingers) beside the table."""

    def __init__(self) -> None:
        """Read the URDF."""
        self._description = describe()
        self._model = pin.buildModelFromUrdf(str(self._description.urdf))
        root = pin.SE3(self._description.T_world_root)
        self._model.jointPlacements[1] = root * self._model.jointPlacements[1]
        for frame in self._model.frames:
            if frame.parentJoint == 0 and frame.name != "universe":
                frame.placement = root * frame.placement
        self._data = self._model.createData()
        self._links = {f.name: i for i, f in enumerate(self._model.frames) if f.type == pin.FrameType.BODY}
        unit = np.random.default_rng(0).uniform(0.2, 0.8, (_RESTARTS, self._model.nq))
        lower, upper = self._description.lower, self._description.upper
        self._restarts = lower + unit * (upper - lower)

    @property
    def description(self) -> RobotDescription:
        """The robot as data."""
        return self._description

    def _link(self, frame: str) -> int:
        if frame not in self._links:
            raise ConfigError(unknown_name("frame of robot 'panda'", frame, self._links))
        return self._links[frame]

    def forward_kinematics(self, q: FloatArray, frame: str) -> FloatArray:
        """Return T_world_frame (4, 4)."""
        index = self._link(frame)
        pin.forwardKinematics(self._model, self._data, q)
        return np.array(pin.updateFramePlacement(self._model, self._data, index).homogeneous)

    def jacobian(self, q: FloatArray, frame: str) -> FloatArray:
        """Return (6, n): linear, then angular velocity, world axes, at the frame's origin."""
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return np.array(pin.computeFrameJacobian(self._model, self._data, q, self._link(frame), world))

    def inverse_kinematics(
        self,
        T_world_frame: FloatArray,
        q_start: FloatArray,
        frame: str,
        *,
        group: str | None = None,
        max_iterations: int = 100,
        position_tolerance: float = 1e-3,
        orientation_tolerance: float = 1e-2,
    ) -> IkSolution:
        """Descend from the start, then from random postures, until a descent reaches."""
        index, joints = self._link(frame), self._description.indices(group or self._description.reach_group(frame))
        if not np.isfinite(T_world_frame).all():
            return IkSolution(q_start.copy(), False, np.inf, np.inf)
        tolerances = np.array([position_tolerance, orientation_tolerance])
        best = self._descend(T_world_frame, q_start, q_start, index, joints, max_iterations, tolerances)
        for restart in self._restarts if max_iterations > _FOLLOWS else ():
            if best.reached:
                break
            other = q_start.copy()
            other[joints] = restart[joints]
            found = self._descend(T_world_frame, other, q_start, index, joints, max_iterations, tolerances)
            best = min(best, found, key=lambda s: (not s.reached, s.position_error + 0.1 * s.orientation_error))
        return best

    def inverse_kinematics_batch(
        self,
        T_world_frames: FloatArray | Sequence[FloatArray],
        q_start: FloatArray,
        frame: str,
        *,
        group: str | None = None,
        max_iterations: int = 100,
        position_tolerance: float = 1e-3,
        orientation_tolerance: float = 1e-2,
    ) -> list[IkSolution]:
        """Solve every target by one descent from the start."""
        index, joints = self._link(frame), self._description.indices(group or self._description.reach_group(frame))
        tolerances = np.array([position_tolerance, orientation_tolerance])
        return [
            self._descend(T, q_start, q_start, index, joints, max_iterations, tolerances)
            if np.isfinite(T).all()
            else IkSolution(q_start.copy(), False, np.inf, np.inf)
            for T in T_world_frames
        ]

    def _descend(
        self,
        target: FloatArray,
        q: FloatArray,
        posture: FloatArray,
        index: int,
        joints: NDArray[np.intp],
        iterations: int,
        tolerances: FloatArray,
    ) -> IkSolution:
        """Follow damped least-squares steps on `joints`, within their limits, that also pull towards `posture`."""
        lower, upper = self._description.lower[joints], self._description.upper[joints]
        q = q.copy()
        q[joints] = np.clip(q[joints], lower, upper)
        pull = _HOMEWARD
        for left in range(iterations, -1, -1):
            J = pin.computeFrameJacobian(self._model, self._data, q, index, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            T = pin.updateFramePlacement(self._model, self._data, index)
            turn = pin.log3(target[:3, :3] @ T.rotation.T)
            error = np.concatenate([target[:3, 3] - T.translation, turn])
            errors = np.array([np.linalg.norm(error[:3]), np.linalg.norm(turn)])
            if left == 0 or np.all(errors <= 0.1 * tolerances):
                break
            J = J[:, joints]
            home = pull * (posture[joints] - q[joints])
            step = home + J.T @ np.linalg.solve(J @ J.T + _DAMPING, error - J @ home)
            step *= min(1.0, _MAX_STEP / max(float(np.abs(step).max()), 1e-12))
            q[joints] = np.clip(q[joints] + step, lower, upper)
            pull *= 0.7
        hit = (q[joints] <= lower) | (q[joints] >= upper)
        names = tuple(self._description.joint_names[i] for i, at in zip(joints, hit, strict=True) if at)
        return IkSolution(q, bool(np.all(errors <= tolerances)), float(errors[0]), float(errors[1]), names)
