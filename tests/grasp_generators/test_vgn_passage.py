"""The way of the hand to a grasp, as the task takes it."""

from __future__ import annotations

import numpy as np
import pytest

from icub_core.data import Grasp
from icub_core.geometry import make_transform, rotation_about
from icub_grasp_generators.hand_geometry import read_hand_geometry
from icub_grasp_generators.vgn.passage import passes

CENTER = np.array([-0.35, 0.0, 1.0])


@pytest.fixture(scope="module")
def geometry(icub):
    return read_hand_geometry(icub, "right")


@pytest.fixture(scope="module")
def grasp():
    R = rotation_about("z", np.pi) @ np.diag([1.0, -1.0, -1.0])  # palm down, fingers forward
    return Grasp(make_transform(R, CENTER + [0.03, 0.0, 0.06]), CENTER, 1.0, "test")


def ball(center) -> np.ndarray:
    points = np.random.default_rng(0).normal(size=(400, 3))
    return center + 0.012 * points / np.linalg.norm(points, axis=1, keepdims=True)


def test_nothing_is_in_the_way_of_a_grasp_from_above(icub, grasp, geometry):
    assert passes(grasp, ball(CENTER), icub, geometry)


def test_something_on_the_straight_way_is_met(icub, grasp, geometry):
    palm = grasp.backed_off(0.07) @ np.array([0.0, 0.0, -0.01, 1.0])
    assert not passes(grasp, ball(palm[:3]), icub, geometry)


def test_something_between_home_and_the_first_pose_is_met(icub, grasp, geometry):
    home = icub.description.home_q
    q = icub.inverse_kinematics(grasp.backed_off(0.10), home, geometry.frame, group="right_reach").q
    halfway = icub.forward_kinematics((home + q) / 2, geometry.frame)
    assert not passes(grasp, ball(halfway[:3, 3]), icub, geometry)
    aside = ball(halfway[:3, 3] + [0.0, 0.0, 0.3])
    assert passes(grasp, aside, icub, geometry)


def test_the_fingers_keep_a_margin_until_they_are_there(icub, grasp, geometry):
    """Points 3 mm beside a sphere of the hand: too close on the way, close enough at the end."""
    hand, T = geometry.hand, grasp.backed_off(0.055)
    lowest = int(np.argmin(hand.at(T)[:, 2] - hand.radii))
    below = hand.at(T)[lowest] - [0.0, 0.0, hand.radii[lowest] + 0.003]
    near = below + 1e-4 * np.random.default_rng(0).normal(size=(50, 3))
    assert geometry.occupancy.count(T[None], near)[0] == 0
    assert not passes(grasp, near, icub, geometry)
