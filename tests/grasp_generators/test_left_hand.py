"""The iCub's left hand grasps like its right one: the robot is asked for it, and the task is told so."""

from __future__ import annotations

import pytest

import icub_core as icub

BOXES = ["003_cracker_box", "004_sugar_box", "008_pudding_box", "010_potted_meat_can"]


def held(objects, worlds: int, episodes: int) -> float:
    env = icub.make_env("grasp", objects=objects, num_envs=worlds, hand="left", overrides=["robot.hands=[left]"])
    try:
        assert env.card()["hand"] == "left"
        return icub.evaluate(icub.load("policy", "demonstrations"), env, episodes=episodes, seed=0).success_rate
    finally:
        env.close()


def test_a_few_boxes_are_held():
    assert held(["004_sugar_box"], 1, 3) > 0.5


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_at_least_half_of_fifty_boxes_are_held():
    """49 of 50 when this was written."""
    assert held(BOXES, 4, 50) >= 0.5
