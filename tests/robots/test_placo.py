"""The same promises by Placo, and the shoulder's cables as constraints."""

import numpy as np
import pytest

from icub_core.errors import ConfigError
from icub_robots.cables import CABLE_MATRIX, CABLE_OFFSET, shoulder
from icub_robots.icub import ICub

pytest.importorskip("placo")
FRAME = "r_hand_dh_frame"


def slack(description, q):
    """Slack (5,) of the right shoulder's cables; negative is overstretched."""
    joints = [description.joint_names.index(name) for name in shoulder("right")]
    return CABLE_MATRIX @ q[joints] + CABLE_OFFSET


@pytest.fixture(scope="module")
def targets(icub):
    d = icub.description
    reach, rng = d.indices("right_reach"), np.random.default_rng(0)
    upper = np.where(np.array(d.joint_names) == "torso_pitch", 0.5, d.upper)
    poses = []
    for _ in range(60):
        q = d.home_q
        q[reach] = rng.uniform(d.lower[reach], upper[reach])
        poses.append(icub.forward_kinematics(q, FRAME))
    return poses


def test_placo_reaches_and_tells_the_truth(icub, targets):
    robot = ICub(kinematics="placo")
    d = icub.description
    others = np.setdiff1d(np.arange(len(d.joint_names)), d.indices("right_reach"))
    reached = 0
    for target in targets:
        solution = robot.inverse_kinematics(target, d.home_q, FRAME)
        T = icub.forward_kinematics(solution.q, FRAME)
        assert solution.position_error == pytest.approx(np.linalg.norm(T[:3, 3] - target[:3, 3]), abs=1e-7)
        assert np.all(solution.q >= d.lower)
        assert np.all(solution.q <= d.upper)
        assert solution.q[0] <= 0.5
        assert np.array_equal(solution.q[others], d.home_q[others])
        reached += solution.reached
    assert reached >= 0.97 * len(targets)


def test_placo_tracks(icub):
    robot = ICub(kinematics="placo")
    q, target = icub.description.home_q, icub.forward_kinematics(icub.description.home_q, FRAME)
    for _ in range(20):
        target = target.copy()
        target[:3, 3] += [-0.0012, 0.001, 0.0012]
        solution = robot.inverse_kinematics(target, q, FRAME, max_iterations=2)
        assert solution.position_error < 2e-4
        assert np.abs(solution.q - q).max() < 0.1
        q = solution.q


def test_out_of_reach_is_typed(icub):
    robot = ICub(kinematics="placo")
    target = icub.forward_kinematics(icub.description.home_q, FRAME)
    target[0, 3] -= 2.0
    solutions = [
        robot.inverse_kinematics(target, icub.description.home_q, FRAME),
        *robot.inverse_kinematics_batch([target], icub.description.home_q, FRAME),
    ]
    for solution in solutions:
        assert not solution.reached
        assert solution.position_error > 0.5


def test_cables_stay_slack_only_when_asked(icub, targets):
    d = icub.description
    starts = [d.home_q for _ in targets]
    worst = {}
    for keep in (True, False):
        robot = ICub(kinematics="placo", cable_limits=keep)
        solutions = [robot.inverse_kinematics(T, q, FRAME) for T, q in zip(targets, starts, strict=True)]
        worst[keep] = min(slack(d, s.q).min() for s in solutions)
    assert worst[True] > -1e-6
    assert worst[False] < -0.01


def test_home_has_slack_cables_and_a_crossed_arm_has_not(icub):
    d = icub.description
    assert slack(d, d.home_q).min() > 1.0
    q = d.home_q
    q[d.indices("right_arm")[:3]] = [-1.6, 2.7, 0.0]
    assert slack(d, q)[0] < 0.0


def test_cables_need_placo():
    with pytest.raises(ConfigError, match="cable_limits needs kinematics 'placo'"):
        ICub(cable_limits=True)


def test_wrong_names_are_named(icub):
    robot = ICub(kinematics="placo")
    with pytest.raises(ConfigError, match="'right_reach'"):
        robot.inverse_kinematics(np.eye(4), icub.description.home_q, FRAME, group="right_reech")
    with pytest.raises(ConfigError, match="neck_yaw"):
        robot.inverse_kinematics(np.eye(4), icub.description.home_q, "head", group="right_arm")
