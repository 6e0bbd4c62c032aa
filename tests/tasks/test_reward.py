"""The reward of thesis 12.3.1, checked by hand on single steps."""

from __future__ import annotations

import numpy as np
import pytest

from icub_tasks.grasping.reward import GraspReward

NO = np.array([False])
YES = np.array([True])


def start(contacts: float = 0, distance: float = 0.05, height: float = 1.0) -> GraspReward:
    reward = GraspReward(1)
    reward.begin(0, contacts=contacts, distance=distance, height=height)
    return reward


def step(reward: GraspReward, contacts: float, distance: float = 0.05, height: float = 1.0, won=NO, lost=NO) -> float:
    return float(reward(np.array([float(contacts)]), np.array([distance]), np.array([height]), won, lost)[0])


def test_new_contacts_are_rewarded_and_lost_ones_punished():
    reward = start()
    assert step(reward, 3) == pytest.approx(3)
    assert step(reward, 1) == pytest.approx(-2)


def test_approaching_is_rewarded_in_CENTIMETERS_and_moving_away_punished():
    reward = start(distance=0.05)
    assert step(reward, 0, distance=0.03) == pytest.approx(2)
    assert step(reward, 0, distance=0.04) == pytest.approx(-1)


def test_distance_counts_only_until_two_fingers_have_touched():
    reward = start(distance=0.05)
    assert step(reward, 1, distance=0.04) == pytest.approx(1 + 1)
    assert step(reward, 2, distance=0.03) == pytest.approx(1)
    assert step(reward, 0, distance=0.01) == pytest.approx(-2)


@pytest.mark.parametrize(("contacts", "expected"), [(0, 0), (1, 0), (2, 2 * 2), (5, 5 * 2)])
def test_a_rise_counts_in_MILLIMETERS_times_contacts_from_two_on(contacts, expected):
    reward = start(contacts=contacts)
    assert step(reward, contacts, height=1.002) == pytest.approx(expected)


def test_a_fall_counts_only_after_two_fingers_have_touched_and_with_the_contacts_left():
    before = start(contacts=1)
    assert step(before, 1, height=0.998) == pytest.approx(0)
    after = start(contacts=3)
    assert step(after, 1, height=0.998) == pytest.approx(-2 + 1 * -2)
    assert step(after, 0, height=0.99) == pytest.approx(-1)


def test_the_end_adds_one_for_success_and_takes_one_for_failure():
    assert step(start(), 0, won=YES) == pytest.approx(1)
    assert step(start(), 0, lost=YES) == pytest.approx(-1)


def test_worlds_do_not_mix_and_the_state_can_be_taken_back():
    reward = GraspReward(2)
    reward.begin(0, contacts=0, distance=0.05, height=1.0)
    reward.begin(1, contacts=2, distance=0.05, height=1.0)
    arguments = (
        np.array([0.0, 2.0]),
        np.array([0.04, 0.04]),
        np.array([1.0, 1.003]),
        np.array([False] * 2),
        np.array([False] * 2),
    )
    kept = reward.state_dict()
    first = reward(*arguments)
    np.testing.assert_allclose(first, [1, 6])
    other = GraspReward(2)
    other.load_state_dict(kept)
    np.testing.assert_array_equal(other(*arguments), first)
