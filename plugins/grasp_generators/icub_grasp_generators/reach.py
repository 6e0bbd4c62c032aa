"""Which hand poses an arm reaches on the whole way: before the grasp, at it, and lifted."""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Grasp
from icub_core.geometry import FloatArray
from icub_core.interfaces.robot import Robot
from icub_core.scene import Table
from icub_grasp_generators.hand_geometry import HandGeometry, read_hand_geometry

_AT_GRASP = (0.0, 0.0)
WAY = (_AT_GRASP, (0.10, 0.0), (0.05, 0.0), (0.0, -0.10))
"""Where the hand must be able to stand: meters before the grasp (thesis 12.3.1: 10 and 5 cm), meters below it."""

_TABLE_CLEARANCE = 0.004
_CHUNK = 100  # candidates that go to inverse kinematics at once
_IK_ITERATIONS = 40
_MAX_JUMP = 0.8  # rad of any joint over 5 cm: beyond, the arm changes its configuration on the way


class HandGeometries:
    """The hands of the robots that were seen, read once each."""

    def __init__(self) -> None:
        self._known: weakref.WeakKeyDictionary[Robot, dict[str, HandGeometry]] = weakref.WeakKeyDictionary()

    def get(self, robot: Robot, hand: str | None = None) -> HandGeometry:
        """Return one hand, the robot's first by default; raises ConfigError when the robot has no such hand."""
        name, hands = robot.description.hand(hand).name, self._known.setdefault(robot, {})
        if name not in hands:
            hands[name] = read_hand_geometry(robot, name)
        return hands[name]


def clears_table(points: FloatArray, radii: FloatArray, table: Table | None) -> NDArray[np.bool_]:
    """Say for sphere centers (..., K, 3) of `radii` (K,) whether all stay out of the table: (...) bool."""
    if table is None:
        return np.ones(points.shape[:-2], dtype=bool)
    center, half = np.asarray(table.center), np.asarray(table.half_size)
    above = points[..., 2] - radii > table.top + _TABLE_CLEARANCE
    beside = np.any(np.abs(points[..., :2] - center[:2]) > half[:2] + radii[:, None] + _TABLE_CLEARANCE, axis=-1)
    return np.all(above | beside, axis=-1)


class Reach:
    """Tests candidates of one hand.

    Args:
        robot: Its arm.
        geometry: Its hand.
        table: What the hand and forearm must not enter.
        posture_weight: Score taken off for each rad^2 of distance from the home posture.
    """

    def __init__(self, robot: Robot, geometry: HandGeometry, table: Table | None, posture_weight: float) -> None:
        self._robot = robot
        self._geometry = geometry
        self._table = table
        self._posture_weight = posture_weight

    def choose(
        self, candidates: list[Grasp], most: int, clear: Callable[[list[Grasp]], NDArray[np.bool_]] | None = None
    ) -> tuple[Grasp, ...]:
        """Return at most `most` of the candidates, which come best first, that are reached on the whole way.

        They are ranked by score less the posture's cost, among the first hundreds that hold twice as many as asked for.

        Args:
            candidates: Best first.
            most: How many are wanted.
            clear: Asked which of those that are reached may be used; None takes all.
        """
        found: list[Grasp] = []
        for first in range(0, len(candidates), _CHUNK):
            part = candidates[first : first + _CHUNK]
            for offset in WAY:
                part = self._kept(part, offset)
            if clear is not None and part:
                part = [grasp for grasp, free in zip(part, clear(part), strict=True) if free]
            found += part
            if len(found) >= 2 * most:
                break
        found.sort(key=lambda grasp: -grasp.score)
        chosen: list[Grasp] = []
        for grasp in found:
            if self._on_one_way(grasp):
                chosen.append(grasp)
            if len(chosen) == most:
                break
        return tuple(chosen)

    def _kept(self, grasps: list[Grasp], offset: tuple[float, float]) -> list[Grasp]:
        """Keep the grasps whose hand can be at an offset of the way; the grasp's own posture is taken off its score."""
        hand, home = self._geometry.hand, self._robot.description.home_q
        free = [clears_table(hand.at(on_way(grasp, offset)), hand.radii, self._table) for grasp in grasps]
        grasps = [grasp for grasp, clear in zip(grasps, free, strict=True) if clear]
        if not grasps:
            return []
        solutions = self._robot.inverse_kinematics_batch(
            [on_way(grasp, offset) for grasp in grasps],
            home,
            self._geometry.frame,
            group=self._geometry.reach,
            max_iterations=_IK_ITERATIONS,
        )
        kept = []
        for grasp, solution in zip(grasps, solutions, strict=True):
            if not solution.reached or not self._forearm_clears(solution.q):
                continue
            posture = float(np.sum((solution.q - home) ** 2)) if offset == _AT_GRASP else 0.0
            kept.append(dataclasses.replace(grasp, score=grasp.score - self._posture_weight * posture))
        return kept

    def _forearm_clears(self, q: FloatArray) -> bool:
        link, forearm = self._geometry.forearm_link, self._geometry.forearm
        if link is None:
            return True
        return bool(clears_table(forearm.at(self._robot.forward_kinematics(q, link)), forearm.radii, self._table))

    def _on_one_way(self, grasp: Grasp) -> bool:
        """Return True if the arm gets from home to the first pre-grasp and on from there without a jump."""
        q = self._robot.description.home_q
        group = self._geometry.reach
        for step, offset in enumerate(sorted(WAY, reverse=True)):
            solution = self._robot.inverse_kinematics(on_way(grasp, offset), q, self._geometry.frame, group=group)
            if not solution.reached or (step > 0 and float(np.abs(solution.q - q).max()) > _MAX_JUMP):
                return False
            q = solution.q
        return True


def on_way(grasp: Grasp, offset: tuple[float, float]) -> FloatArray:
    """Return the hand pose (4, 4) at (meters before, meters below) a grasp."""
    T = grasp.backed_off(offset[0]) if offset[0] else grasp.T_world_hand.copy()
    T[2, 3] -= offset[1]
    return T
