"""Whatever a policy asks for, position, speed and acceleration stay inside their boxes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from icub_core.governor import SafetyGovernor

LOWER, UPPER = np.array([-1.0, 0.0, -0.2]), np.array([1.0, 3.0, 0.2])
SPEED, ACCELERATION = np.array([2.0, 16.0, 0.5]), np.array([20.0, 600.0, 3.0])
STEP = 0.025
WORKSPACE = np.array([[-0.6, -0.4, 0.9], [0.0, 0.5, 1.6]])
SLACK = 1e-9


def governor(worlds: int = 1) -> SafetyGovernor:
    return SafetyGovernor(LOWER, UPPER, SPEED, ACCELERATION, STEP, WORKSPACE, worlds)


commands = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 60), st.just(2), st.just(3)),
    elements=st.floats(-50, 50) | st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1.0, 3.0, 0.0]),
)
starts = hnp.arrays(np.float64, (3,), elements=st.floats(-5, 5))


@settings(max_examples=200, deadline=None)
@given(commands, starts)
def test_all_three_boxes_hold_for_any_commands(stream, start):
    guard = governor(worlds=2)
    for world in range(2):
        guard.begin(world, start)
    last = np.tile(np.clip(start, LOWER, UPPER), (2, 1))
    speed = np.zeros_like(last)
    for command in stream:
        sent = guard.limit(command).copy()
        assert np.isfinite(sent).all()
        assert (sent >= LOWER).all()
        assert (sent <= UPPER).all()
        now = (sent - last) / STEP
        assert (np.abs(now) <= SPEED * (1 + SLACK) + SLACK).all()
        assert (np.abs(now - speed) <= ACCELERATION * STEP * (1 + SLACK) + 1e-6).all()
        last, speed = sent, now


@settings(max_examples=100, deadline=None)
@given(hnp.arrays(np.float64, (4, 15), elements=st.floats(allow_nan=True, allow_infinity=True)))
def test_any_action_becomes_a_finite_one_within_bounds(actions):
    clean, bad = governor(4).clean_actions(actions)
    assert np.isfinite(clean).all()
    assert (np.abs(clean) <= 1).all()
    np.testing.assert_array_equal(bad, ~np.isfinite(actions).all(axis=1))


def test_commands_inside_the_boxes_pass_unchanged():
    guard = governor()
    guard.begin(0, np.array([0.0, 1.0, 0.0]))
    wanted = np.array([[0.005, 1.2, 0.0005]])
    np.testing.assert_allclose(guard.limit(wanted), wanted, atol=1e-15)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_command_that_is_not_finite_stops_that_world_until_its_next_begin(bad):
    guard = governor(2)
    for world in range(2):
        guard.begin(world, np.array([0.0, 1.0, 0.0]))
    guard.limit(np.array([[0.01, 1.1, 0.0]] * 2))
    guard.limit(np.array([[bad, 1.2, 0.0], [0.02, 1.2, 0.0]]))
    np.testing.assert_array_equal(guard.held, [True, False])
    for _ in range(20):
        held = guard.limit(np.array([[0.5, 2.0, 0.1]] * 2)).copy()
    np.testing.assert_array_equal(guard.limit(np.array([[0.5, 2.5, 0.1]] * 2))[0], held[0])
    guard.begin(0, held[0])
    moved = guard.limit(np.array([[0.5, 2.5, 0.1]] * 2)).copy()
    assert (moved[0] != held[0]).any()


def test_hand_positions_are_kept_in_the_workspace():
    far = np.array([[5.0, -5.0, 0.0], [-0.3, 0.1, 1.1]])
    np.testing.assert_allclose(governor().limit_position(far), [[0.0, -0.4, 0.9], [-0.3, 0.1, 1.1]])


def test_state_can_be_taken_back():
    guard, other = governor(), governor()
    guard.begin(0, np.array([0.0, 1.0, 0.0]))
    guard.limit(np.array([[1.0, 3.0, 0.2]]))
    other.load_state_dict(guard.state_dict())
    np.testing.assert_array_equal(guard.limit(np.array([[1.0, 3.0, 0.2]])), other.limit(np.array([[1.0, 3.0, 0.2]])))
