"""A complete plugin: after `pip install .` it runs with `icub run +policy=demonstrations grasp_generator=top_down`."""

import numpy as np

from icub_core.data import Grasp, GraspProposals, PointCloud
from icub_core.geometry import invert, make_transform, rotation_about
from icub_core.interfaces.grasp_generator import GraspGenerator


class TopDown(GraspGenerator):
    """The palm straight down onto the middle of the object, turned about the vertical until the arm can reach it.

    Args:
        clearance: Height of the palm above the object's top, meters.
    """

    def __init__(self, clearance: float = 0.04):
        self.clearance = clearance

    def propose(self, cloud: PointCloud, robot, table, hand: str | None = None) -> GraspProposals:
        """Propose every reachable one of eight directions, the easiest for the arm first."""
        points = cloud.points
        if len(points) < 10 or not np.isfinite(points).all() or np.ptp(points, axis=0).max() > 0.4:
            return GraspProposals((), None, f"a cloud of {len(points)} points is no graspable object")
        center, d, grasps = (points.min(0) + points.max(0)) / 2, robot.description, []
        palm = d.hand(hand)  # the robot's first hand where none is named
        for yaw in np.arange(8) * np.pi / 4:
            R = rotation_about("z", yaw) @ rotation_about("x", np.pi)  # the grip's z, out of the palm, is down
            T_grip = make_transform(R, [*center[:2], points[:, 2].max() + self.clearance])
            T = T_grip @ invert(palm.grip.T_hand_grip)
            grasp = Grasp(T, center, 0.0, "top_down", palm.name)
            poses = [grasp.backed_off(distance) for distance in (0.0, 0.05, 0.10)]
            found = robot.inverse_kinematics_batch(poses, d.home_q, palm.frame, group=palm.reach)
            if all(solution.reached for solution in found):
                effort = float(np.abs(found[0].q - d.home_q).sum())
                grasps.append(Grasp(T, center, -effort, "top_down", palm.name))
        grasps.sort(key=lambda grasp: -grasp.score)
        return GraspProposals(tuple(grasps), center, "" if grasps else "the arm reaches none of eight directions")
