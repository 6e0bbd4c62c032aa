"""What was not seen where the fitted solid says that something is costs a pose; what was seen costs nothing."""

from __future__ import annotations

import numpy as np
import pytest

from icub_core.geometry import make_transform, rotation_about
from icub_grasp_generators.superquadrics.evidence import Evidence
from icub_grasp_generators.superquadrics.shape import Superquadric
from icub_grasp_generators.synthetic_clouds import surface

HALF = np.array([0.03, 0.025, 0.09])  # a tall carton
CENTER = np.array([-0.35, 0.0, 1.04])
SWEEP = np.array([[-0.020, 0.085], [-0.050, 0.050], [0.0, 0.075]])  # the iCub's hand
EYE = CENTER + [0.4, -0.3, 0.25]
SOLID = Superquadric.from_parts(HALF, np.array([0.05, 0.05]), np.eye(3), CENTER)


def image(count: int = 3000, seed: int = 0) -> np.ndarray:
    """Points of the carton as a camera spreads them: evenly over the image."""
    rng = np.random.default_rng(seed)
    local, normals = surface("box", HALF, rng, 60_000)
    points = local + CENTER
    to_eye = EYE - points
    weight = np.maximum((normals * to_eye).sum(axis=1), 0) / np.linalg.norm(to_eye, axis=1) ** 3
    return points[rng.choice(len(points), count, replace=False, p=weight / weight.sum())]


def hand_at(height: float) -> np.ndarray:
    """A hand from the side, its fingers closing along the world's x axis, `height` meters above the carton's middle."""
    R = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]).T
    return make_transform(R, CENTER + [0, 0, height] - R @ np.array([0.033, -0.002, 0.03]))[None]


HIGH, LOW = hand_at(0.045), hand_at(-0.045)


def test_hands_of_the_test_are_rotations_that_span_the_carton():
    for T in (HIGH, LOW):
        assert np.linalg.det(T[0, :3, :3]) == pytest.approx(1.0)
        np.testing.assert_allclose((CENTER - T[0, :3, 3]) @ T[0, :3, 0], 0.033, atol=1e-9)


def test_a_solid_that_was_seen_costs_nothing():
    evidence = Evidence(SOLID, image(), EYE, SWEEP)
    assert evidence.cost(HIGH)[0] == 0.0
    assert evidence.cost(LOW)[0] == 0.0


def test_where_half_of_the_solid_was_not_seen_poses_cost_more_the_less_was_seen():
    points = image()
    half_seen = points[(points[:, 2] > CENTER[2]) | (np.arange(len(points)) % 4 == 0)]
    unseen = points[points[:, 2] > CENTER[2]]
    some, none = (Evidence(SOLID, cloud, EYE, SWEEP) for cloud in (half_seen, unseen))
    assert none.cost(HIGH)[0] == some.cost(HIGH)[0] == 0.0
    assert 0.5 < some.cost(LOW)[0] < none.cost(LOW)[0]
    assert none.cost(LOW)[0] > 1.5


def test_poses_that_close_around_nothing_of_either_are_not_scored():
    evidence = Evidence(SOLID, image(), EYE, SWEEP)
    assert evidence.cost(hand_at(0.5))[0] == 0.0


def test_shares_of_the_image_are_those_of_a_camera():
    """Through the whole solid's grasp region: what a camera sees and what is expected agree for any turn of it."""
    for yaw in (0.0, 0.4, 1.1):
        R = rotation_about("z", yaw)
        solid = Superquadric.from_parts(HALF, np.array([0.05, 0.05]), R, CENTER)
        rng = np.random.default_rng(1)
        local, normals = surface("box", HALF, rng, 60_000)
        points = local @ R.T + CENTER
        to_eye = EYE - points
        weight = np.maximum((normals @ R.T * to_eye).sum(axis=1), 0) / np.linalg.norm(to_eye, axis=1) ** 3
        cloud = points[rng.choice(len(points), 3000, replace=False, p=weight / weight.sum())]
        evidence = Evidence(solid, cloud, EYE, SWEEP)
        for height in (-0.06, 0.0, 0.06):
            assert evidence.cost(hand_at(height))[0] < 0.1
