"""The grasp generator `superquadrics`: fit, hand poses, reachability."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Grasp, GraspProposals, PointCloud
from icub_core.errors import DataError
from icub_core.geometry import FloatArray
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.robot import Robot
from icub_core.scene import Table
from icub_grasp_generators.clouds import CLOUD_POINTS, MAX_TOUCHED, thin
from icub_grasp_generators.hand_geometry import Occupancy
from icub_grasp_generators.planned_hand import MIRROR
from icub_grasp_generators.reach import HandGeometries, Reach
from icub_grasp_generators.superquadrics.evidence import Evidence
from icub_grasp_generators.superquadrics.fit import fit_superquadric
from icub_grasp_generators.superquadrics.poses import evaluate, family
from icub_grasp_generators.superquadrics.shape import Superquadric

NAME = "superquadrics"

_MIN_INLIERS = 0.5
_APPROACH = (0.0, 0.015, 0.03, 0.045)  # meters before the grasp where the open hand must be clear of the cloud
_APPROACH_POINTS, _APPROACH_TOUCHED = 1000, 5
_POSTURE_WEIGHT = 0.1  # cost per rad^2 of distance from the home posture


class Superquadrics(GraspGenerator):
    """Grasps around a superquadric that is fitted to the cloud.

    Every candidate pose of the family in `poses` is tested against table, solid and cloud, and costed; the cheapest are
    tried by inverse kinematics at the grasp, 5 and 10 cm before it and 10 cm above it, and ranked by cost plus distance
    from the home posture.

    Args:
        max_grasps: At most this many are returned.
        max_tries: At most this many candidates go to inverse kinematics.

    Source: thesis 12.3.1; Vezzani et al. 2017 for model and costs. There one pose is found by constrained optimization
    and neither reachability nor the whole hand is looked at; here poses are enumerated, so that what fails can be
    passed over.
    """

    def __init__(self, max_grasps: int = 5, max_tries: int = 400) -> None:
        self._max_grasps = max_grasps
        self._max_tries = max_tries
        self._hands = HandGeometries()

    def propose(self, cloud: PointCloud, robot: Robot, table: Table | None, hand: str | None = None) -> GraspProposals:
        """Fit, enumerate, test; see the interface. Raises ConfigError when the robot has no such hand."""
        geometry = self._hands.get(robot, hand)
        planned, name = geometry.planned, geometry.name
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

        shape, seen = _mirrored(fit.shape) if planned.is_mirrored else fit.shape, planned.cloud(cloud)
        evidence = None if seen.viewpoint is None else Evidence(shape, seen.points, seen.viewpoint, planned.sweep)
        candidates, reason = evaluate(
            shape, family(shape, planned), planned, geometry.planned_body, planned.table(table), evidence
        )
        if reason:
            return GraspProposals((), center, reason)
        T_world_hand = planned.to_hand(candidates.T)
        # what the solid does not model, such as the cap of a bottle, is still in the way
        free = geometry.occupancy.count(T_world_hand, thin(cloud.points, CLOUD_POINTS)) <= MAX_TOUCHED
        if not free.any():
            return GraspProposals((), center, "at every pose around the object the open hand meets points of the cloud")
        best = np.nonzero(free)[0][: self._max_tries]
        tries = [Grasp(T_world_hand[i], center, -float(candidates.cost[i]), NAME, name) for i in best]
        obstacle = thin(cloud.points, _APPROACH_POINTS)
        grasps = Reach(robot, geometry, table, _POSTURE_WEIGHT).choose(
            tries, self._max_grasps, lambda reached: _clear_on_approach(reached, geometry.occupancy, obstacle)
        )
        if not grasps:
            reason = f"the {name} arm reaches none of {len(tries)} poses around the object without pushing it"
            return GraspProposals((), center, reason)
        return GraspProposals(grasps, center)


def _clear_on_approach(grasps: list[Grasp], occupancy: Occupancy, cloud: FloatArray) -> NDArray[np.bool_]:
    """Say of which grasps (C,) the open hand meets hardly a point of the cloud (N, 3) on its last way."""
    clear = np.ones(len(grasps), dtype=bool)
    for before in _APPROACH:
        clear &= occupancy.count(np.array([g.backed_off(before) for g in grasps]), cloud) <= _APPROACH_TOUCHED
    return clear


def _mirrored(shape: Superquadric) -> Superquadric:
    """Mirror a solid at the robot's plane of symmetry; a superquadric is its own mirror image along x."""
    T = MIRROR @ shape.T_world_object @ np.diag([-1.0, 1.0, 1.0, 1.0])
    return Superquadric(shape.half_axes, shape.exponents, T)
