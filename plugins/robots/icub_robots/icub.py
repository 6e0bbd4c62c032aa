"""The simulated iCub: a description, and kinematics by the library of choice."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from icub_core.errors import ConfigError, DataError, unknown_name
from icub_core.geometry import FloatArray
from icub_core.interfaces.robot import GazeSolution, IkSolution, Robot
from icub_core.robot_description import RobotDescription
from icub_core.scene import Table
from icub_robots.body import LimitSet
from icub_robots.description import Coupling, describe
from icub_robots.gaze import Gaze
from icub_robots.hand_table import Side
from icub_robots.kinematics.base import IkRequest, Kinematics, restart_postures
from icub_robots.kinematics.model import PinocchioModel
from icub_robots.kinematics.pinocchio_kinematics import PinocchioKinematics
from icub_robots.kinematics.settings import RESTARTS
from icub_robots.models import BODY_MODEL, Model

if TYPE_CHECKING:
    from icub_robots.collision import CollisionChecker

Library = Literal["pinocchio", "placo"]


class ICub(Robot):
    """The iCub with articulated hands.

    Args:
        hands: Hands with fingers, ``"right"``, ``"left"`` or both, the one to grasp with first; the arm of a hand that
            is not named is welded.
        limits: Joint limits: ``"ikin"`` (those of the real robot's arm solver) or ``"urdf"``.
        coupling: ``"tendon"`` (under-actuated fingers) or ``"equal_split"`` (coupled joints stay equal).
        weld: Fix legs and unused arms at home.
        kinematics: Inverse kinematics by ``"pinocchio"`` (fast, restarts, batches) or ``"placo"`` (quadratic program).
        torso_pitch_max: Upper limit of torso_pitch in inverse kinematics, rad (thesis 12.3: 0.5).
        cable_limits: Inverse kinematics also keeps the shoulders' cables slack, as the real robot needs; placo only.
        model: ``"iCubGazeboV2_5_visuomanip"`` gives the hands that model's meshes, to show and to collide; it needs an
            icub-models built from its sources. Kinematics and masses are the same.
    """

    def __init__(
        self,
        hands: tuple[Side, ...] = ("right",),
        limits: LimitSet = "ikin",
        coupling: Coupling = "tendon",
        weld: bool = True,
        kinematics: Library = "pinocchio",
        torso_pitch_max: float = 0.5,
        cable_limits: bool = False,
        model: Model = BODY_MODEL,
    ) -> None:
        if kinematics not in get_args(Library):
            raise ConfigError(unknown_name("kinematics library", kinematics, get_args(Library)))
        if cable_limits and kinematics != "placo":
            raise ConfigError(f"cable_limits needs kinematics 'placo', not '{kinematics}'")
        self._description = describe(tuple(hands), limits, coupling, weld, model)
        self._model = PinocchioModel(self._description)
        lower, upper = self._description.lower.copy(), self._description.upper.copy()
        torso_pitch = self._description.joint_names.index("torso_pitch")
        if not torso_pitch_max > lower[torso_pitch]:
            raise ConfigError(
                f"torso_pitch_max is {torso_pitch_max} rad; expected above the joint's lower limit, "
                f"{lower[torso_pitch]:.3f}"
            )
        upper[torso_pitch] = min(upper[torso_pitch], torso_pitch_max)
        starts = restart_postures(self._description.home_q, lower, upper, RESTARTS)
        self._kinematics: Kinematics
        if kinematics == "placo":
            from icub_robots.kinematics.placo_kinematics import PlacoKinematics

            self._kinematics = PlacoKinematics(self._model, lower, upper, starts, cable_limits)
        else:
            self._kinematics = PinocchioKinematics(self._model, lower, upper, starts)

    @property
    def description(self) -> RobotDescription:
        """The robot as data."""
        return self._description

    def forward_kinematics(self, q: FloatArray, frame: str) -> FloatArray:
        """Return T_world_frame (4, 4) of a link at `q` (n,)."""
        return self._model.forward_kinematics(q, frame)

    def jacobian(self, q: FloatArray, frame: str) -> FloatArray:
        """Return the (6, n) Jacobian of a link: linear then angular, world axes, at the link's origin."""
        return self._model.jacobian(q, frame)

    def pose_and_jacobian(self, q: FloatArray, frame: str) -> tuple[FloatArray, FloatArray]:
        """Return `forward_kinematics` and `jacobian` of one `q` (n,), from one pass over the chain."""
        return self._model.pose_and_jacobian(q, frame)

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
        """Place `frame`; see the interface. Up to 10 iterations only follow from `q_start`, more may restart."""
        request = IkRequest(max_iterations, position_tolerance, orientation_tolerance)
        self._check_start(q_start)
        if not np.isfinite(T_world_frame).all():
            return _unreachable(q_start)
        return self._kinematics.solve(T_world_frame, q_start, frame, self._moving(frame, group), request)

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
        """Solve many targets (k, 4, 4) from one start, each by one descent; see the interface."""
        request = IkRequest(max_iterations, position_tolerance, orientation_tolerance)
        self._check_start(q_start)
        targets = np.asarray(T_world_frames, dtype=np.float64).reshape(-1, 4, 4)
        finite = np.all(np.isfinite(targets), axis=(1, 2))
        group = self._moving(frame, group)
        solved = iter(self._kinematics.solve_batch(targets[finite], q_start, frame, group, request))
        return [next(solved) if good else _unreachable(q_start) for good in finite]

    @cached_property
    def _gaze(self) -> Gaze:
        return Gaze(self._model)

    def gaze(self, point: FloatArray, q_start: FloatArray, camera: str | None = None) -> GazeSolution:
        """Turn the neck so that `camera` looks at `point` (3,), within 8.1 degrees; see the interface."""
        self._check_start(q_start)
        return self._gaze.solve(point, q_start, self._description.camera(camera))

    @cached_property
    def _collision_checker(self) -> CollisionChecker:
        from icub_robots.collision import CollisionChecker  # its hulls take a second

        return CollisionChecker(self._model)

    def collisions(self, q: FloatArray, table: Table | None = None, margin: float = 0.0) -> tuple[tuple[str, str], ...]:
        """Return the pairs that touch at `q` (n,); see the interface. The first call takes about a second."""
        self._check_start(q)
        return self._collision_checker.collisions(q, table, margin)

    def _moving(self, frame: str, group: str | None) -> str:
        """Return the joint group to solve for: that of the hand whose frame it is where none is named."""
        return self._description.reach_group(frame) if group is None else group

    def _check_start(self, q_start: FloatArray) -> None:
        if q_start.shape != self._description.lower.shape or not np.isfinite(q_start).all():
            raise DataError(
                f"q_start has shape {q_start.shape} or is not finite; expected {self._description.lower.shape} joint "
                "positions, rad"
            )


def _unreachable(q_start: FloatArray) -> IkSolution:
    return IkSolution(q_start.copy(), False, float("inf"), float("inf"))
