"""A grasp generator as version 0.1 documented it: it works with a warning, or stops with one line."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from icub_core.data import PointCloud
from icub_core.errors import ConfigError
from icub_core.scene import Table
from icub_testing.tiny.robot import TinyRobot

OLD = '''
import numpy as np

from icub_core.data import Grasp, GraspProposals, PointCloud
from icub_core.geometry import make_transform, rotation_about
from icub_core.interfaces.grasp_generator import GraspGenerator


class TopDown(GraspGenerator):
    """The palm straight down onto the middle of the object, turned about the vertical until the arm can reach it.

    Args:
        clearance: Height of the hand frame above the object's top, metres.
    """

    def __init__(self, clearance: float = 0.04):
        self.clearance = clearance

    def propose(self, cloud: PointCloud, robot, table, hand: str = "right") -> GraspProposals:
        """Propose every reachable one of eight directions, the easiest for the arm first."""
        points = cloud.points
        if len(points) < 10 or not np.isfinite(points).all() or np.ptp(points, axis=0).max() > 0.4:
            return GraspProposals((), None, f"a cloud of {len(points)} points is no graspable object")
        center, d, grasps = (points.min(0) + points.max(0)) / 2, robot.description, []
        for yaw in np.arange(8) * np.pi / 4:
            R = rotation_about("z", yaw) @ rotation_about("x", np.pi)
            T = make_transform(R, [*center[:2], points[:, 2].max() + self.clearance])
            grasp = Grasp(T, center, 0.0, "top_down", hand)
            poses = [grasp.backed_off(distance) for distance in (0.0, 0.05, 0.10)]
            found = robot.inverse_kinematics_batch(poses, d.home_q, d.hand_frames[hand], group=f"{hand}_reach")
            if all(solution.reached for solution in found):
                effort = float(np.abs(found[0].q - d.home_q).sum())
                grasps.append(Grasp(T, center, -effort, "top_down", hand))
        grasps.sort(key=lambda grasp: -grasp.score)
        return GraspProposals(tuple(grasps), center, "" if grasps else "the arm reaches none of eight directions")
'''


@pytest.fixture(scope="module")
def old(tmp_path_factory):
    path = tmp_path_factory.mktemp("old") / "old_top_down.py"
    path.write_text(OLD)
    spec = importlib.util.spec_from_file_location("old_top_down", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.TopDown()


@pytest.fixture(scope="module")
def icub():
    from icub_robots.icub import ICub

    return ICub(hands=("right", "left"))


def cloud() -> PointCloud:
    half = np.array([0.03, 0.03, 0.05])
    points = np.random.default_rng(0).uniform(-1, 1, (500, 3)) * half
    return PointCloud(points + [-0.35, 0.0, Table().top + half[2]])


def test_it_proposes_for_the_icub_and_warns(old, icub):
    with pytest.warns(DeprecationWarning, match=r"use description\.hand\(name\)\.frame"):
        answer = old.propose(cloud(), icub, Table(), "right")
    assert answer, answer.reason
    assert answer.grasps[0].hand == "right"


def test_for_a_robot_of_other_hands_it_stops_with_a_line_that_names_the_version(old):
    told = r"hand 'right'; since version 0\.2 .*claw"
    with pytest.warns(DeprecationWarning, match="hand_frames"), pytest.raises(ConfigError, match=told):
        old.propose(cloud(), TinyRobot(), Table())


@pytest.mark.parametrize(
    ("name", "attribute"), [("hand_frames", "frame"), ("hand_actuators", "actuators"), ("fingertips", "fingertips")]
)
def test_the_old_tables_hold_what_the_hands_say(icub, name, attribute):
    description = icub.description
    with pytest.warns(DeprecationWarning, match=name):
        table = getattr(description, name)
    assert table == {hand.name: getattr(hand, attribute) for hand in description.hands.values()}
