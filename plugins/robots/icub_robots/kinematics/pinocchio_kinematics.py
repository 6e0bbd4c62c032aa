"""Kinematics by Pinocchio: damped least squares, one solver per frame and group."""

from __future__ import annotations

from icub_core.geometry import FloatArray
from icub_core.interfaces.robot import IkSolution
from icub_robots.kinematics.base import IkRequest, Kinematics
from icub_robots.kinematics.damped_least_squares import ChainIk
from icub_robots.kinematics.model import PinocchioModel


class PinocchioKinematics(Kinematics):
    """Damped least squares with limits, null-space posture and restarts.

    Args:
        model: The robot.
        lower: (n,) limits of inverse kinematics, rad.
        upper: (n,) limits of inverse kinematics, rad.
        restarts: (k, n) further starts of a solve that is not tracking and did not reach.
    """

    def __init__(self, model: PinocchioModel, lower: FloatArray, upper: FloatArray, restarts: FloatArray) -> None:
        self._model = model
        self._lower, self._upper = lower, upper
        self._restarts = restarts
        self._chains: dict[tuple[str, str], ChainIk] = {}

    def _chain(self, frame: str, group: str) -> ChainIk:
        chain = self._chains.get((frame, group))
        if chain is None:
            chain = self._chains[frame, group] = ChainIk(self._model, frame, group, self._lower, self._upper)
        return chain

    def solve(self, target: FloatArray, q_start: FloatArray, frame: str, group: str, request: IkRequest) -> IkSolution:
        """Place `frame` at `target` (4, 4) with the joints of `group`, from `q_start` (n,)."""
        restarts = None if request.tracking else self._restarts
        return self._chain(frame, group).solve(target, q_start, request, restarts)

    def solve_batch(
        self, targets: FloatArray, q_start: FloatArray, frame: str, group: str, request: IkRequest
    ) -> list[IkSolution]:
        """Solve every target (k, 4, 4) by one descent from `q_start` (n,), without restarts."""
        return self._chain(frame, group).solve_batch(targets, q_start, request)
