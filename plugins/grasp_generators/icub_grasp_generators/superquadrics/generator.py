"""The grasp generator `superquadrics`: fit, hand poses, reachability."""

from __future__ import annotations

import dataclasses
import weakref

import numpy as np

from icub_core.data import Grasp, GraspProposals, PointCloud
from icub_core.errors import DataError
from icub_core.geometry import FloatArray
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.robot import Robot
from icub_core.scene import Table
from icub_grasp_generators.hand_geometry import HandGeometry, Spheres, read_hand_geometry
from icub_grasp_generators.superquadrics.fit import fit_superquadric
from icub_grasp_generators.superquadrics.poses import clears_table, evaluate, family
from icub_grasp_generators.superquadrics.shape import Superquadric
from icub_grasp_generators.superquadrics.start import thin

NAME = "superquadrics"

_AT_GRASP = (0.0, 0.0)
_WAY = (_AT_GRASP, (0.10, 0.0), (0.05, 0.0), (0.0, -0.10))
"""Where the hand must be able to stand: metres before the grasp (thesis 12.3.1: 10 and 5 cm), metres below it."""

_MIN_INLIERS = 0.5
_CLOUD_POINTS = 250
_MAX_TOUCHED = 4  # of them inside the open hand: sensor noise, not an obstacle
_CHUNK = 100  # candidates that go to inverse kinematics at once
_IK_ITERATIONS = 40
_MAX_JUMP = 0.8  # rad of any joint over 5 cm: beyond, the arm changes its configuration on the way
_POSTURE_WEIGHT = 0.1  # cost per rad^2 of distance from the home posture

_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])  # the robot's plane of symmetry
_FLIP = np.diag([1.0, 1.0, -1.0, 1.0])  # a left hand's palm looks along -z of its frame


class Superquadrics(GraspGenerator):
    """Grasps around a superquadric that is fitted to the cloud.

    Every candidate pose of the family in `poses` is tested against table, solid and cloud, and costed; the cheapest are
    tried by inverse kinematics at the grasp, 5 and 10 cm before it and 10 cm above it, and ranked by cost plus distance
    from the home posture.

    Args:
        max_grasps: At most this many are returned.
        max_tries: At most this many candidates go to inverse kinematics.

    Source: thesis 12.3.1; Vezzani et al. 2017 for model and costs. There one pose is found by constrained optimisation
    and neither reachability nor the whole hand is looked at; here poses are enumerated, so that what fails can be
    passed over.
    """

    def __init__(self, max_grasps: int = 5, max_tries: int = 400) -> None:
        self._max_grasps = max_grasps
        self._max_tries = max_tries
        self._hands: weakref.WeakKeyDictionary[Robot, dict[str, HandGeometry]] = weakref.WeakKeyDictionary()

    def propose(self, cloud: PointCloud, robot: Robot, table: Table | None, hand: str = "right") -> GraspProposals:
        """Fit, enumerate, test; see the interface. Raises ConfigError when the robot has no such hand."""
        geometry = self._geometry(robot, hand)
        if cloud.frame != "world":
            return GraspProposals((), reason=f"the cloud is given in the frame '{cloud.frame}'; expected 'world'")
        try:
            fit = fit_superquadric(cloud.points, None if table is None else table.top)
        except DataError as error:
            return GraspProposals((), reason=str(error))
        center = fit.shape.center.copy()
        if fit.inliers < _MIN_INLIERS:
            share = 100 * (1 - fit.inliers)
            return GraspProposals((), center, f"{share:.0f} % of the cloud's points do not lie on one superquadric")

        # a left hand grasps the mirror image of what a right hand grasps
        shape, body, board = fit.shape, geometry.hand, table
        if hand == "left":
            shape, body, board = (
                _mirrored(shape),
                Spheres(body.centers * [1.0, 1.0, -1.0], body.radii),
                _mirrored_table(table),
            )
        candidates, reason = evaluate(shape, family(shape), body, board)
        if reason:
            return GraspProposals((), center, reason)
        T_world_hand = _MIRROR @ candidates.T @ _FLIP if hand == "left" else candidates.T
        # what the solid does not model, such as the cap of a bottle, is still in the way
        free = geometry.occupancy.count(T_world_hand, thin(cloud.points, _CLOUD_POINTS)) <= _MAX_TOUCHED
        if not free.any():
            return GraspProposals((), center, "at every pose around the object the open hand meets points of the cloud")
        T_world_hand, cost = T_world_hand[free], candidates.cost[free]
        grasps = self._reachable(T_world_hand, cost, center, robot, geometry, table, hand)
        if not grasps:
            tried = min(len(T_world_hand), self._max_tries)
            return GraspProposals((), center, f"the {hand} arm reaches none of {tried} hand poses around the object")
        return GraspProposals(grasps, center)

    def _geometry(self, robot: Robot, hand: str) -> HandGeometry:
        known = self._hands.setdefault(robot, {})
        if hand not in known:
            known[hand] = read_hand_geometry(robot, hand)
        return known[hand]

    def _reachable(
        self,
        T_world_hand: FloatArray,
        cost: FloatArray,
        center: FloatArray,
        robot: Robot,
        geometry: HandGeometry,
        table: Table | None,
        hand: str,
    ) -> tuple[Grasp, ...]:
        """Return the best candidates (C, 4, 4) that the arm reaches on the whole way, ranked with their postures."""
        found: list[Grasp] = []
        for first in range(0, min(len(T_world_hand), self._max_tries), _CHUNK):
            part = slice(first, min(first + _CHUNK, self._max_tries))
            grasps = [
                Grasp(T, center, -float(c), NAME, hand) for T, c in zip(T_world_hand[part], cost[part], strict=True)
            ]
            for offset in _WAY:
                grasps = self._kept(grasps, offset, robot, geometry, table)
            found += grasps
            if len(found) >= 2 * self._max_grasps:
                break
        found.sort(key=lambda grasp: -grasp.score)
        chosen: list[Grasp] = []
        for grasp in found:
            if self._on_one_way(grasp, robot, geometry):
                chosen.append(grasp)
            if len(chosen) == self._max_grasps:
                break
        return tuple(chosen)

    def _on_one_way(self, grasp: Grasp, robot: Robot, geometry: HandGeometry) -> bool:
        """Say whether the arm gets from home to the first pre-grasp and from there, without a jump, along the way."""
        q = robot.description.home_q
        group = f"{grasp.hand}_reach"
        for step, offset in enumerate(sorted(_WAY, reverse=True)):
            solution = robot.inverse_kinematics(_on_way(grasp, offset), q, geometry.frame, group=group)
            if not solution.reached or (step > 0 and float(np.abs(solution.q - q).max()) > _MAX_JUMP):
                return False
            q = solution.q
        return True

    def _kept(
        self,
        grasps: list[Grasp],
        offset: tuple[float, float],
        robot: Robot,
        geometry: HandGeometry,
        table: Table | None,
    ) -> list[Grasp]:
        """Keep the grasps whose hand can be at an offset of the way; the grasp's own posture is added to its cost."""
        free = [clears_table(geometry.hand.at(_on_way(g, offset)), geometry.hand.radii, table) for g in grasps]
        grasps = [grasp for grasp, clear in zip(grasps, free, strict=True) if clear]
        if not grasps:
            return []
        home = robot.description.home_q
        solutions = robot.inverse_kinematics_batch(
            [_on_way(grasp, offset) for grasp in grasps],
            home,
            geometry.frame,
            group=f"{grasps[0].hand}_reach",
            max_iterations=_IK_ITERATIONS,
        )
        kept = []
        for grasp, solution in zip(grasps, solutions, strict=True):
            if not solution.reached:
                continue
            if geometry.forearm_link is not None:
                forearm = geometry.forearm.at(robot.forward_kinematics(solution.q, geometry.forearm_link))
                if not clears_table(forearm, geometry.forearm.radii, table):
                    continue
            posture = float(np.sum((solution.q - home) ** 2)) if offset == _AT_GRASP else 0.0
            kept.append(dataclasses.replace(grasp, score=grasp.score - _POSTURE_WEIGHT * posture))
        return kept


def _on_way(grasp: Grasp, offset: tuple[float, float]) -> FloatArray:
    """Return the hand pose (4, 4) at (metres before, metres below) a grasp."""
    T = grasp.backed_off(offset[0]) if offset[0] else grasp.T_world_hand.copy()
    T[2, 3] -= offset[1]
    return T


def _mirrored(shape: Superquadric) -> Superquadric:
    """Mirror a solid at the robot's plane of symmetry; a superquadric is its own mirror image along x."""
    T = _MIRROR @ shape.T_world_object @ np.diag([-1.0, 1.0, 1.0, 1.0])
    return Superquadric(shape.half_axes, shape.exponents, T)


def _mirrored_table(table: Table | None) -> Table | None:
    if table is None:
        return None
    return Table((table.center[0], -table.center[1], table.center[2]), table.half_size, table.material)
