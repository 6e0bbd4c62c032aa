"""A grasp generator and a policy of a few lines: straight down onto the middle, then close the hand."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDictBase

from icub_core.data import Grasp, GraspProposals, PointCloud
from icub_core.geometry import make_transform, rotation_about
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.policy import Policy
from icub_core.interfaces.robot import Robot
from icub_core.scene import Table

MIN_POINTS = 10
LARGEST = 0.5
PRE_GRASPS = (0.0, 0.05, 0.10)
"""Distances before the grasp at which the hand must be able to stand, meters."""


class TinyGraspGenerator(GraspGenerator):
    """One palm-down grasp at the middle of the cloud, and the same turned by a quarter.

    Args:
        clearance: Height of the hand frame above the highest point, meters.
    """

    def __init__(self, clearance: float = 0.05) -> None:
        self._clearance = clearance

    def propose(self, cloud: PointCloud, robot: Robot, table: Table | None, hand: str | None = None) -> GraspProposals:
        """Propose what can be reached."""
        points = cloud.points
        if len(points) < MIN_POINTS:
            return GraspProposals((), None, f"the cloud has {len(points)} points; expected at least {MIN_POINTS}")
        if not np.all(np.isfinite(points)):
            return GraspProposals((), None, "the cloud holds NaN or infinite coordinates")
        low, high = points.min(axis=0), points.max(axis=0)
        if np.any(high - low > LARGEST):
            return GraspProposals((), None, f"the cloud is wider than {LARGEST} m; expected one object")
        center = (low + high) / 2
        description, chosen = robot.description, robot.description.hand(hand)
        grasps = []
        for score, yaw in ((1.0, 0.0), (0.5, np.pi / 2)):
            T = make_transform(
                rotation_about("z", yaw) @ rotation_about("x", np.pi), [*center[:2], high[2] + self._clearance]
            )
            grasp = Grasp(T, center, score, "tiny", chosen.name)
            frame = chosen.frame
            reach = (robot.inverse_kinematics(grasp.backed_off(d), description.home_q, frame) for d in PRE_GRASPS)
            if all(solution.reached for solution in reach):
                grasps.append(grasp)
        return GraspProposals(tuple(grasps), center, "" if grasps else "inverse kinematics reaches no pose")


class TinyPolicy(Policy):
    """Closes the hand until something is felt, then lifts it.

    Args:
        speed: Action of the finger joints, 0..1.
    """

    def __init__(self, speed: float = 0.5) -> None:
        self._speed = speed

    def act(self, observation: TensorDictBase) -> torch.Tensor:
        """Return actions (B, 6 + F): lift, or close the F actuators."""
        touch, fingers = observation["touch"], observation["fingers"]
        action = torch.zeros((len(touch), 6 + fingers.shape[1]), dtype=torch.float32)
        felt = (touch.sum(dim=1) >= 2).float()
        action[:, 2] = felt
        action[:, 6:] = (1 - felt)[:, None] * self._speed
        return action
