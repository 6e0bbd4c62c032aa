"""What a kinematics library has to do for the robot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from icub_core.geometry import FloatArray
from icub_core.interfaces.robot import IkSolution


@dataclass(frozen=True)
class IkRequest:
    """How far and how well to solve.

    Attributes:
        max_iterations: Of one descent.
        position_tolerance: Meters.
        orientation_tolerance: Radians.
    """

    max_iterations: int = 100
    position_tolerance: float = 1e-3
    orientation_tolerance: float = 1e-2

    @property
    def tracking(self) -> bool:
        """Whether this only follows a moving target: one descent from the start, no restarts."""
        return self.max_iterations <= 10


def restart_postures(home: FloatArray, lower: FloatArray, upper: FloatArray, count: int) -> FloatArray:
    """Return (count, n) starts: home, then random postures of the middle of the ranges, the same ones for ever."""
    unit = np.random.default_rng(0).uniform(0.2, 0.8, (max(count, 1), len(lower)))
    postures = lower + unit * (upper - lower)
    postures[0] = home
    return postures[:count]


class Kinematics(ABC):
    """Inverse kinematics by one library. Joint vectors are the description's; world frame; never raises for a pose."""

    @abstractmethod
    def solve(self, target: FloatArray, q_start: FloatArray, frame: str, group: str, request: IkRequest) -> IkSolution:
        """Place `frame` at `target` (4, 4) with the joints of `group`, from `q_start` (n,)."""

    def solve_batch(
        self, targets: FloatArray, q_start: FloatArray, frame: str, group: str, request: IkRequest
    ) -> list[IkSolution]:
        """Solve every target (k, 4, 4) from `q_start` (n,)."""
        return [self.solve(target, q_start, frame, group, request) for target in targets]
