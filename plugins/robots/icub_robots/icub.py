"""The simulated iCub: a description and Pinocchio kinematics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import ConfigError
from icub_core.interfaces.robot import IkSolution, Robot
from icub_core.robot_description import RobotDescription
from icub_robots.description import describe
from icub_robots.kinematics.damped_least_squares import TRACKING_ITERATIONS, ChainIk
from icub_robots.kinematics.model import PinocchioModel

FloatArray = NDArray[np.float64]


class ICub(Robot):
    """The iCub with articulated hands.

    Args:
        hands: Hands with fingers, ``"right"`` and/or ``"left"``; the arm of a hand that is not named is welded.
        limits: Joint limits: ``"ikin"`` (those of the real robot's arm solver) or ``"urdf"``.
        coupling: ``"tendon"`` (under-actuated fingers) or ``"equal_split"`` (coupled joints stay equal).
        weld: Fix legs and unused arms at home.
        torso_pitch_max: Upper limit of torso_pitch in inverse kinematics, rad (thesis 12.3: 0.5).
        restarts: Further starts of a descent that did not reach, when it was allowed more than 10 iterations.
    """

    def __init__(
        self,
        hands: tuple[str, ...] = ("right",),
        limits: str = "ikin",
        coupling: str = "tendon",
        weld: bool = True,
        torso_pitch_max: float = 0.5,
        restarts: int = 4,
    ) -> None:
        self._description = describe(tuple(hands), limits, coupling, weld)
        self._model = PinocchioModel(self._description)
        self._lower = self._description.lower.copy()
        self._upper = self._description.upper.copy()
        torso_pitch = self._description.joint_names.index("torso_pitch")
        if not self._lower[torso_pitch] < torso_pitch_max:
            raise ConfigError(
                f"torso_pitch_max is {torso_pitch_max} rad; expected above the joint's lower limit, "
                f"{self._lower[torso_pitch]:.3f}"
            )
        self._upper[torso_pitch] = min(self._upper[torso_pitch], torso_pitch_max)
        self._restarts = self._make_restarts(restarts)
        self._chains: dict[tuple[str, str], ChainIk] = {}

    def _make_restarts(self, count: int) -> FloatArray:
        """Home, then fixed random postures in the middle of the ranges: (count, n)."""
        low, high = self._lower, self._upper
        unit = np.random.default_rng(0).uniform(0.2, 0.8, (max(count, 1), len(low)))
        starts = low + unit * (high - low)
        starts[0] = self._description.home_q
        return starts[:count]

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

    def inverse_kinematics(
        self,
        T_world_frame: FloatArray,
        q_start: FloatArray,
        frame: str,
        *,
        group: str = "right_reach",
        max_iterations: int = 100,
        position_tolerance: float = 1e-3,
        orientation_tolerance: float = 1e-2,
    ) -> IkSolution:
        """Place `frame`; see the interface. Up to 10 iterations track from `q_start` only, more may restart."""
        chain = self._chains.get((frame, group))
        if chain is None:
            chain = self._chains[frame, group] = ChainIk(self._model, frame, group, self._lower, self._upper)
        restarts = self._restarts if max_iterations > TRACKING_ITERATIONS else None
        return chain.solve(
            T_world_frame, q_start, max_iterations, position_tolerance, orientation_tolerance, restarts
        )
