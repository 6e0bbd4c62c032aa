"""Faulty grasp generators and policies."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from icub_core.data import Grasp, GraspProposals, PointCloud
from icub_core.geometry import make_transform, rotation_about, rotation_exp
from icub_core.interfaces.policy import LearnReport
from icub_testing.tiny.skills import TinyGraspGenerator, TinyPolicy

from .base import breaks


def _one(T, center, hand="claw"):
    return GraspProposals((Grasp(T, center, 1.0, "faulty", hand),), center)


@breaks("grasp_generator", "check_proposes")
class HoversFarAbove(TinyGraspGenerator):
    def __init__(self) -> None:
        super().__init__(clearance=0.5)


@breaks("grasp_generator", "check_order")
class WorstGraspFirst(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        answer = super().propose(cloud, robot, table, hand)
        return replace(answer, grasps=answer.grasps[::-1])


@breaks("grasp_generator", "check_hand")
class OtherHand(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        answer = super().propose(cloud, robot, table, hand)
        return replace(answer, grasps=tuple(replace(grasp, hand="left") for grasp in answer.grasps))


@breaks("grasp_generator", "check_reachable")
class PreGraspOutOfReach(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        answer = super().propose(cloud, robot, table, hand)
        if not answer:
            return answer
        beside = answer.object_center + np.array([0.30, 0.0, 0.02])
        return _one(make_transform(rotation_about("y", -np.pi / 2), beside), answer.object_center)


@breaks("grasp_generator", "check_table")
class HandInTheTable(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        answer = super().propose(cloud, robot, table, hand)
        if not answer:
            return answer
        low = answer.object_center.copy()
        low[1:] = 0.1, table.top - 0.03
        return _one(make_transform(rotation_about("x", np.pi), low), answer.object_center)


@breaks("grasp_generator", "check_empty_cloud")
class NeedsACloud(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        cloud.points.min(axis=0)
        return super().propose(cloud, robot, table, hand)


@breaks("grasp_generator", "check_few_points")
class ContentWithTwoPoints(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        return super().propose(PointCloud(np.tile(cloud.points, (10, 1))), robot, table, hand)


@breaks("grasp_generator", "check_not_finite")
class FailsOnNaN(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        if np.isnan(cloud.points).any():
            raise np.linalg.LinAlgError("SVD did not converge")
        return super().propose(cloud, robot, table, hand)


@breaks("grasp_generator", "check_degenerate")
class InvertsTheSpread(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        if len(cloud) > 2 and np.isfinite(cloud.points).all():
            np.linalg.inv(np.round(np.cov(cloud.points.T), 12))
        return super().propose(cloud, robot, table, hand)


@breaks("grasp_generator", "check_too_large")
class GraspsAnything(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        if not np.isfinite(cloud.points).all() or len(cloud) == 0:
            return super().propose(cloud, robot, table, hand)
        middle = (cloud.points.min(axis=0) + cloud.points.max(axis=0)) / 2
        return super().propose(PointCloud(np.clip(cloud.points, middle - 0.1, middle + 0.1)), robot, table, hand)


@breaks("grasp_generator", "check_unreachable")
class NeverAsksTheRobot(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        answer = super().propose(cloud, robot, table, hand)
        if answer.object_center is None:
            return answer
        above = answer.object_center + np.array([0.0, 0.0, 0.13])
        return _one(make_transform(rotation_about("x", np.pi), above), answer.object_center)


@breaks("grasp_generator", "check_repeatable")
class TurnsAtRandom(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        answer = super().propose(cloud, robot, table, hand)
        turn = make_transform(rotation_exp([0.0, 0.0, 0.01 * np.random.default_rng().random()]))
        return replace(answer, grasps=tuple(replace(g, T_world_hand=g.T_world_hand @ turn) for g in answer.grasps))


@breaks("grasp_generator", "check_inputs_unchanged")
class RoundsTheCloud(TinyGraspGenerator):
    def propose(self, cloud, robot, table, hand=None):
        np.round(cloud.points, 3, out=cloud.points)
        return super().propose(cloud, robot, table, hand)


@breaks("policy", "check_actions")
class DoubleActions(TinyPolicy):
    def act(self, observation):
        return super().act(observation).double()


@breaks("policy", "check_extreme_observations")
class Unclipped(TinyPolicy):
    def act(self, observation):
        action = super().act(observation)
        action[:, 0] = 5 * (observation["object_center"][:, 0] - observation["hand_pose"][:, 0])
        return action


@breaks("policy", "check_repeatable")
class RemembersExtremes(TinyPolicy):
    largest = 0.0

    def act(self, observation):
        self.largest = max(self.largest, float(observation["hand_pose"].abs().max()))
        action = super().act(observation)
        action[:, 0] = min(1.0, 1 / self.largest)
        return action


@breaks("policy", "check_rows_apart")
class NormalizesActionsOverTheBatch(TinyPolicy):
    def act(self, observation):
        action = super().act(observation)
        x = observation["hand_pose"][:, 0]
        action[:, 0] = torch.tanh(x - x.mean())
        return action


@breaks("policy", "check_two_alike")
class RandomSpeed(TinyPolicy):
    def __init__(self) -> None:
        super().__init__(speed=float(np.random.default_rng().random()))

    def save(self, path):
        Path(path).write_text(json.dumps(self._speed))

    def load(self, path):
        self._speed = json.loads(Path(path).read_text())


@breaks("policy", "check_inputs_unchanged")
class WritesItsAction(TinyPolicy):
    def act(self, observation):
        observation["action"] = super().act(observation)
        return observation["action"]


@breaks("policy", "check_save_and_load")
class SavesInexactly(TinyPolicy):
    def save(self, path):
        Path(path).write_text(f"{self._speed:.0f}")

    def load(self, path):
        self._speed = float(Path(path).read_text())


@breaks("policy", "check_learning")
class LearnsNothing(TinyPolicy):
    def learn(self, task, run_dir=None, progress=None, *, seconds=None):
        return LearnReport(seconds=seconds)
