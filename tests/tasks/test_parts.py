"""Tracking, angles, ends of an episode, statistics: the parts of the task that need no physics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from icub_benchmarks.statistics import paired_gain
from icub_core.construct import build
from icub_core.errors import ConfigError
from icub_core.geometry import rotation_exp, rotation_log
from icub_core.interfaces.robot import Robot
from icub_core.rollouts import EpisodeResults, wilson_interval
from icub_tasks.grasping.spaces import euler_to_matrix, hand_layout, matrix_to_euler, pose_vector
from icub_tasks.grasping.termination import EndReason, end_reasons
from icub_tasks.grasping.tracking import HandTracker, small_rotation


@pytest.fixture(scope="module")
def robot() -> Robot:
    return build("robot", "icub")


@given(st.lists(st.floats(-6, 6), min_size=3, max_size=3))
def test_euler_angles_are_rx_ry_rz_and_invert(angles):
    yaw, pitch, roll = angles
    R = euler_to_matrix(np.array(angles))
    np.testing.assert_allclose(R, Rotation.from_euler("XYZ", [roll, pitch, yaw]).as_matrix(), atol=1e-12)
    back = matrix_to_euler(R)
    assert (back[[0, 2]] >= 0).all()
    np.testing.assert_allclose(euler_to_matrix(back), R, atol=1e-6)


@given(st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3))
def test_small_rotations_are_exact_logarithms(vector):
    R = rotation_exp(np.array(vector))
    np.testing.assert_allclose(small_rotation(R[None])[0], rotation_log(R), atol=1e-9)


def test_the_hand_follows_a_moving_target_to_a_tenth_of_a_millimetre(robot):
    layout = hand_layout(robot.description)
    tracker = HandTracker(robot, layout)
    q = np.tile(robot.description.home_q, (3, 1))
    targets = np.tile(pose_vector(robot.forward_kinematics(q[0], layout.hand.frame)), (3, 1))
    for _ in range(40):
        targets[:, :3] += [[-0.001, -0.001, -0.001], [0.0, -0.002, 0.0], [0.0, 0.0, -0.002]]
        targets[:, 3:] += 0.003
        errors = tracker.follow(q, targets)
    reached = np.stack([pose_vector(robot.forward_kinematics(row, layout.hand.frame)) for row in q])
    assert np.abs(reached[:, :3] - targets[:, :3]).max() < 1e-4
    assert np.abs(euler_to_matrix(reached[:, 3:]) - euler_to_matrix(targets[:, 3:])).max() < 1e-3
    assert errors.max() < 1e-3


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6))
def test_tracking_never_leaves_the_joint_limits_and_says_what_it_could_not_do(robot, direction):
    layout = hand_layout(robot.description)
    tracker, joints = HandTracker(robot, layout), layout.reach_joints
    q = robot.description.home_q[None].copy()
    target = pose_vector(robot.forward_kinematics(q[0], layout.hand.frame))[None]
    for _ in range(60):
        target += 0.02 * np.array(direction)
        errors = tracker.follow(q, target)
        assert (q[:, joints] >= robot.description.lower[joints] - 1e-12).all()
        assert (q[:, joints] <= robot.description.upper[joints] + 1e-12).all()
    assert np.isfinite(errors).all()


def test_a_hand_that_the_robot_lacks_is_named(robot):
    with pytest.raises(ConfigError, match="no hand of robot 'icub' named 'rihgt'. Did you mean 'right'"):
        hand_layout(robot.description, "rihgt")


@pytest.mark.parametrize(
    ("displacement", "contacts", "steps", "expected"),
    [
        ((0, 0, 0.0), 0, 10, EndReason.RUNNING),
        ((0, 0, 0.10), 2, 10, EndReason.SUCCESS),
        ((0, 0, 0.12), 1, 10, EndReason.RUNNING),  # lifted, but not held by two fingers
        ((0.11, 0, 0.0), 0, 10, EndReason.MOVED),
        ((0.06, 0.06, 0.0), 0, 10, EndReason.RUNNING),
        ((0.08, 0.08, 0.0), 0, 10, EndReason.MOVED),
        ((0, 0, -0.03), 3, 10, EndReason.MOVED),
        ((0.11, 0, 0.11), 3, 10, EndReason.SUCCESS),
        ((0, 0, 0.0), 5, 100, EndReason.TIME_LIMIT),
        ((0, 0, 0.11), 5, 100, EndReason.SUCCESS),
    ],
)
def test_ends_of_an_episode(displacement, contacts, steps, expected):
    reasons = end_reasons(
        np.array([displacement], dtype=float), np.array([float(contacts)]), np.array([steps]),
        lift=0.1, moved=0.1, fallen=0.02, max_steps=100,
    )  # fmt: skip
    assert reasons[0] == expected


def test_wilson_interval_equals_published_values():
    low, high = wilson_interval(81, 263)  # Newcombe 1998, table I
    assert low == pytest.approx(0.2553, abs=1e-4)
    assert high == pytest.approx(0.3662, abs=1e-4)
    assert wilson_interval(0, 10)[0] == 0
    assert wilson_interval(10, 10)[1] == pytest.approx(1)


def results(success: list[bool], name: str = "can") -> EpisodeResults:
    count = len(success)
    return EpisodeResults(np.array(success), np.zeros(count), np.ones(count, int), np.ones(count, int), (name,) * count)


def test_a_paired_gain_counts_the_episodes_in_which_two_policies_differ():
    gain, (low, high) = paired_gain(results([True] * 90 + [False] * 10), results([True] * 70 + [False] * 30))
    assert gain == pytest.approx(0.2)
    assert 0.1 < low < 0.2 < high < 0.3
    assert paired_gain(results([True, False]), results([True, False]))[1] == (0, 0)


def test_results_of_other_episodes_cannot_be_paired():
    with pytest.raises(ConfigError, match="same episodes"):
        paired_gain(results([True]), results([True], "box"))
