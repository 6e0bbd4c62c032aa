"""Contract of grasp generators. The robot is the tiny one, whose hand hangs from a gantry and reaches everywhere."""

from __future__ import annotations

import numpy as np

from icub_core.data import GraspProposals, PointCloud
from icub_core.errors import ConfigError
from icub_core.geometry import FloatArray
from icub_core.scene import Table
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_raises, expect_same
from icub_testing.tiny.robot import TinyRobot

TABLE = Table()
BOTTLE = (0.03, 0.03, 0.08)
"""Half extents of the object, meters."""
PLACE = np.array([-0.35, 0.0, TABLE.top + BOTTLE[2]])
NEAR_OBJECT = 0.35
"""No hand that holds the object has its frame farther from the object's center, meters."""
PRE_GRASPS = (0.0, 0.05, 0.10)
HAND_THICKNESS = 0.01
"""Meters by which the middle of a fingertip link may be below the table top, for links drawn from their near joint."""


def _surface(center: FloatArray = PLACE, half: FloatArray | tuple[float, float, float] = BOTTLE) -> PointCloud:
    """Sample the four sides and the top of a box, as seen from all around: (N, 3), world."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (1500, 3))
    face = rng.integers(0, 5, 1500)
    axis = np.array([0, 0, 1, 1, 2])[face]
    points[np.arange(1500), axis] = np.array([-1, 1, -1, 1, 1])[face]
    return PointCloud(center + points * np.asarray(half))


def _proposed(make: Make, cloud: PointCloud | None = None) -> GraspProposals:
    answer: GraspProposals = make().propose(_surface() if cloud is None else cloud, TinyRobot(), TABLE)
    expect(isinstance(answer, GraspProposals), "GraspProposals", type(answer).__name__)
    return answer


def _refused(make: Make, cloud: PointCloud, what: str) -> None:
    answer = _proposed(make, cloud)
    expect(not answer.grasps, f"no grasps for {what}", f"{len(answer.grasps)} grasps")
    expect(
        answer.reason.strip() and "\n" not in answer.reason, f"the reason in one line for {what}", repr(answer.reason)
    )


def check_proposes(make: Make) -> None:
    """An upright box of a bottle's size, seen from all sides, has at least one grasp, near it and in meters."""
    answer = _proposed(make)
    expect(answer.grasps, "at least one grasp", f"none: {answer.reason}")
    expect(answer.object_center is not None, "the object's center", None)
    for grasp in answer.grasps:
        distance = float(np.linalg.norm(grasp.T_world_hand[:3, 3] - PLACE))
        expect(
            distance < NEAR_OBJECT,
            f"a hand within {NEAR_OBJECT} m of the object, in the world frame",
            f"{distance:.2f} m",
        )
        off = float(np.linalg.norm(grasp.object_center - PLACE))
        expect(off < max(BOTTLE), "an object center inside the object", f"one {off:.2f} m off")


def check_order(make: Make) -> None:
    """Grasps come best score first."""
    scores = [grasp.score for grasp in _proposed(make).grasps]
    expect(scores == sorted(scores, reverse=True), "falling scores", scores)


def check_hand(make: Make) -> None:
    """Grasps are for the hand that was asked for, the first one where none was; an unknown one raises ConfigError."""
    robot, unnamed = TinyRobot(), _proposed(make)
    name = robot.description.hand().name
    hands = {grasp.hand for grasp in unnamed.grasps}
    expect(hands <= {name}, "the first hand", hands)
    named = make().propose(_surface(), robot, TABLE, name)
    expect(len(named.grasps) == len(unnamed.grasps), "as many grasps of the hand by its name", len(named.grasps))
    expect_raises(ConfigError, lambda: make().propose(_surface(), robot, TABLE, "no_such_hand"), "for an unknown hand")


def check_reachable(make: Make) -> None:
    """The robot reaches every grasp and its pre-grasps 5 cm and 10 cm before."""
    robot = TinyRobot()
    for grasp in make().propose(_surface(), robot, TABLE).grasps:
        for distance in PRE_GRASPS:
            pose = grasp.backed_off(distance)
            solution = robot.inverse_kinematics(pose, robot.description.home_q, robot.description.hand().frame)
            expect(
                solution.reached, f"a pose {distance} m before the grasp that is reached", pose[:3, 3].round(3).tolist()
            )


def check_table(make: Make) -> None:
    """The open hand of a proposed grasp stays above the table."""
    robot = TinyRobot()
    description = robot.description
    for grasp in make().propose(_surface(), robot, TABLE).grasps:
        solution = robot.inverse_kinematics(grasp.T_world_hand, description.home_q, description.hand().frame)
        for link in (*description.hand().fingertips, description.hand().frame):
            height = float(robot.forward_kinematics(solution.q, link)[2, 3]) - TABLE.top
            expect(height > -HAND_THICKNESS, f"'{link}' above the table top", f"{100 * height:.1f} cm")


def check_empty_cloud(make: Make) -> None:
    """An empty cloud gives no grasps and the reason."""
    _refused(make, PointCloud(np.zeros((0, 3))), "an empty cloud")


def check_few_points(make: Make) -> None:
    """Two points give no grasps and the reason."""
    _refused(make, PointCloud(_surface().points[:2]), "a cloud of two points")


def check_not_finite(make: Make) -> None:
    """A cloud of NaN gives no grasps and the reason."""
    _refused(make, PointCloud(np.full((500, 3), np.nan)), "a cloud of NaN")


def check_degenerate(make: Make) -> None:
    """A cloud on a plane, on a line or in one place gives grasps or the reason in one line, no error."""
    points = _surface().points
    top, corner = points[points[:, 2] > PLACE[2] + 0.999 * BOTTLE[2]], points.min(axis=0)
    line = np.tile(corner, (200, 1))
    line[:, 0] += np.linspace(0.0, 0.1, 200)
    for what, cloud in (("plane", top), ("line", line), ("place", np.tile(corner, (200, 1)))):
        answer = _proposed(make, PointCloud(cloud.copy()))
        told = bool(answer.reason.strip()) and "\n" not in answer.reason
        expect(
            answer.grasps or told, f"grasps or the reason in one line for a cloud on one {what}", repr(answer.reason)
        )


def check_too_large(make: Make) -> None:
    """A cloud that no hand can hold gives no grasps and the reason."""
    _refused(make, _surface(np.array([-0.4, 0.0, TABLE.top + 0.2]), (0.4, 0.4, 0.2)), "a cloud of 0.8 m")


def check_unreachable(make: Make) -> None:
    """An object out of reach gives no grasps and the reason."""
    _refused(make, _surface(np.array([-5.0, 0.0, TABLE.top + BOTTLE[2]])), "an object five meters away")


def check_repeatable(make: Make) -> None:
    """The same cloud gives the same grasps."""
    first, second = _proposed(make), _proposed(make)
    expect(
        len(first.grasps) == len(second.grasps), "as many grasps again", f"{len(first.grasps)}, {len(second.grasps)}"
    )
    for one, other in zip(first.grasps, second.grasps, strict=True):
        expect_same(one.T_world_hand, other.T_world_hand, "poses of the same cloud")


def check_inputs_unchanged(make: Make) -> None:
    """The cloud that is passed in is not changed."""
    cloud = _surface()
    _proposed(make, cloud)
    expect_same(cloud.points, _surface().points, "the cloud before and after")
