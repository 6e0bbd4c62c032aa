"""Grasp generator: from a point cloud to hand poses."""

from __future__ import annotations

from abc import ABC, abstractmethod

from icub_core.data import GraspProposals, PointCloud
from icub_core.interfaces.robot import Robot
from icub_core.scene import Table


class GraspGenerator(ABC):
    """Proposes poses of a hand from which closing the fingers should hold the object.

    Contract: poses are rigid, in meters, in the world frame, best first; only poses that the robot reaches (grasp, 5 cm
    and 10 cm pre-grasp by IK) and that do not put the open hand into the table are returned; a cloud that cannot be
    used (empty, a few points, NaN, too large) gives no grasps and the reason, never an exception; the same cloud and
    seed give the same answer.
    """

    @abstractmethod
    def propose(self, cloud: PointCloud, robot: Robot, table: Table | None, hand: str | None = None) -> GraspProposals:
        """Propose grasps of the object whose visible surface is `cloud` (world frame).

        Args:
            cloud: Surface points of one object, without the table.
            robot: Gives the hand's description and the reachability.
            table: What the hand must not enter, if there is one.
            hand: Name of the hand; None takes the robot's first.
        """
