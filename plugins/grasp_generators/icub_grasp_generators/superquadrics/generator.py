"""The grasp generator `superquadrics`: fit, hand poses, reachability."""

from __future__ import annotations

import logging
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

logger = logging.getLogger(__name__)

_BACK_OFF = (0.10, 0.05)  # metres; thesis 12.3.1
_MIN_INLIERS = 0.5
_IK_ITERATIONS = 10  # one descent from home, no restarts: cheap enough for many candidates
_POSITION_TOLERANCE = 2e-3
_ORIENTATION_TOLERANCE = 0.02
_POSTURE_WEIGHT = 0.1  # cost per rad^2 of distance from the home posture

_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])  # the robot's plane of symmetry
_FLIP = np.diag([1.0, 1.0, -1.0, 1.0])  # a left hand's palm looks along -z of its frame


class Superquadrics(GraspGenerator):
    """Grasps around a superquadric that is fitted to the cloud.

    Every candidate pose of the family in `poses` is tested against table and solid and costed; the cheapest are tried by
    inverse kinematics at the grasp and 5 and 10 cm before it, and ranked by cost plus distance from the home posture.

    Args:
        max_grasps: At most this many are returned.
        max_tries: At most this many candidates go to inverse kinematics.

    Source: thesis 12.3.1; Vezzani et al. 2017 for model and costs. There one pose is found by constrained optimisation
    and neither reachability nor the whole hand is looked at; here poses are enumerated, so that what fails can be
    passed over.
    """

    def __init__(self, max_grasps: int = 5, max_tries: int = 80) -> None:
        self._max_grasps = max_grasps
        self._max_tries = max_tries
        self._hands: weakref.WeakKeyDictionary[Robot, dict[str, HandGeometry]] = weakref.WeakKeyDictionary()

    def propose(self, cloud: PointCloud, robot: Robot, table: Table | None, hand: str = "right") -> GraspProposals:
        """Fit, enumerate, test; see the interface. Raises ConfigError when the robot has no such hand."""
        geometry = self._geometry(robot, hand)
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
        grasps = self._reachable(T_world_hand, candidates.cost, center, robot, geometry, table, hand)
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
        home = robot.description.home_q
        found: list[tuple[float, Grasp]] = []
        for T, c in zip(T_world_hand[: self._max_tries], cost[: self._max_tries], strict=True):
            grasp = Grasp(T, center, -float(c), "superquadrics", hand)
            posture = self._posture_cost(grasp, robot, geometry, table, home)
            if posture is not None:
                total = float(c) + _POSTURE_WEIGHT * posture
                found.append((total, Grasp(T, center, -total, "superquadrics", hand)))
                if len(found) >= 3 * self._max_grasps:
                    break
        found.sort(key=lambda pair: pair[0])
        return tuple(grasp for _, grasp in found[: self._max_grasps])

    def _posture_cost(
        self, grasp: Grasp, robot: Robot, geometry: HandGeometry, table: Table | None, home: FloatArray
    ) -> float | None:
        """Squared distance of the grasp's arm posture from home, or None when grasp or way to it cannot be reached."""
        q = home
        for T in (*(grasp.backed_off(d) for d in _BACK_OFF), grasp.T_world_hand):
            solution = robot.inverse_kinematics(
                T,
                q,
                geometry.frame,
                group=f"{grasp.hand}_reach",
                max_iterations=_IK_ITERATIONS,
                position_tolerance=_POSITION_TOLERANCE,
                orientation_tolerance=_ORIENTATION_TOLERANCE,
            )
            if not solution.reached:
                return None
            q = solution.q
            if not clears_table(geometry.hand.at(T), geometry.hand.radii, table):
                return None
            if geometry.forearm_link is not None:
                forearm = geometry.forearm.at(robot.forward_kinematics(q, geometry.forearm_link))
                if not clears_table(forearm, geometry.forearm.radii, table):
                    return None
        return float(np.sum((q - home) ** 2))


def _mirrored(shape: Superquadric) -> Superquadric:
    """Mirror a solid at the robot's plane of symmetry; a superquadric is its own mirror image along x."""
    T = _MIRROR @ shape.T_world_object @ np.diag([-1.0, 1.0, 1.0, 1.0])
    return Superquadric(shape.half_axes, shape.exponents, T)


def _mirrored_table(table: Table | None) -> Table | None:
    if table is None:
        return None
    return Table((table.center[0], -table.center[1], table.center[2]), table.half_size, table.material)
