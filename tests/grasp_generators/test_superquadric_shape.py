"""The superquadric as a norm, against its textbook formula, samples and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icub_core.errors import DataError
from icub_core.geometry import rotation_exp
from icub_grasp_generators.superquadrics.residuals import (
    Solids,
    columns,
    evaluate,
    outline,
    outline_jacobian,
    rotations,
    viewers,
)
from icub_grasp_generators.superquadrics.shape import EXPONENT_RANGE, Superquadric

axes = st.tuples(*[st.floats(0.01, 0.2)] * 3)
powers = st.tuples(*[st.floats(*EXPONENT_RANGE)] * 2)
turns = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
places = st.tuples(*[st.floats(-0.5, 0.5)] * 3)


def make(half, exponents, turn=(0.0, 0.0, 0.0), place=(0.0, 0.0, 0.0)) -> Superquadric:
    return Superquadric.from_parts(np.array(half), np.array(exponents), rotation_exp(turn), np.array(place))


@given(axes, st.tuples(*[st.floats(0.2, 1.3)] * 2), turns, places, st.integers(0, 99))
@settings(deadline=None)
def test_gauge_is_the_textbook_inside_outside_function(half, exponents, turn, place, seed):
    solid = make(half, exponents, turn, place)
    points = np.random.default_rng(seed).uniform(-0.4, 0.4, (50, 3)) + np.array(place)
    x, y, z = np.abs(((points - solid.center) @ solid.T_world_object[:3, :3]) / half).T
    e1, e2 = exponents
    F = (x ** (2 / e2) + y ** (2 / e2)) ** (e2 / e1) + z ** (2 / e1)
    np.testing.assert_allclose(solid.gauge(points), F ** (e1 / 2), rtol=1e-7, atol=1e-9)


@given(axes, powers, turns, places)
@settings(deadline=None)
def test_surface_points_have_gauge_one_and_no_distance(half, exponents, turn, place):
    solid = make(half, exponents, turn, place)
    points = solid.surface(200)
    np.testing.assert_allclose(solid.gauge(points), 1.0, atol=1e-6)
    assert np.abs(solid.distance(points)).max() < 1e-6
    np.testing.assert_allclose(np.linalg.norm(solid.normals(points), axis=1), 1.0, atol=1e-9)


def test_distance_in_front_of_a_flat_face_is_euclidean():
    box = make((0.05, 0.03, 0.08), (0.05, 0.05))
    for axis in range(3):
        point = np.zeros(3)
        point[axis] = box.half_axes[axis] + 0.02
        assert box.distance(point) == pytest.approx(0.02, abs=1e-6)


@given(axes, powers, turns, places, st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_support_function_bounds_the_surface_and_is_reached(half, exponents, turn, place, seed):
    solid = make(half, exponents, turn, place)
    direction = np.random.default_rng(seed).normal(size=3)
    direction /= np.linalg.norm(direction)
    reach, furthest = solid.support(direction)
    sampled = (solid.surface(3000) - solid.center) @ direction
    assert sampled.max() <= reach + 1e-9
    assert reach == pytest.approx((furthest - solid.center) @ direction, rel=1e-6)
    assert solid.gauge(furthest) == pytest.approx(1.0, abs=1e-4)


def test_support_of_an_ellipsoid_is_its_closed_form():
    solid = make((0.02, 0.05, 0.08), (1.0, 1.0), (0.3, -0.2, 0.9))
    direction = np.array([0.6, 0.0, 0.8])
    expected = np.linalg.norm(solid.half_axes * (solid.T_world_object[:3, :3].T @ direction))
    assert solid.support(direction)[0] == pytest.approx(expected, rel=1e-9)


def test_impossible_solids_are_refused_in_one_line():
    with pytest.raises(DataError, match="half_axes"):
        make((0.0, 0.1, 0.1), (1.0, 1.0))
    with pytest.raises(DataError, match="exponents"):
        make((0.1, 0.1, 0.1), (2.0, 1.0))


def solids_of(half, exponents, turn, place) -> Solids:
    vector = np.concatenate([place, np.log(half), exponents])[None]
    return Solids(rotation_exp(turn)[None], vector)


def numerical(function, solids: Solids) -> np.ndarray:
    """Central differences by the eleven parameters; the outputs come first: (..., 11)."""
    differences = []
    for i in range(11):
        h = 1e-6
        step = np.zeros((1, 11))
        step[0, i] = h
        far = np.full(8, 1e9)
        differences.append(
            (function(solids.moved(step, -far, far)) - function(solids.moved(-step, -far, far))) / (2 * h)
        )
    return np.stack(differences, axis=-1)


inner_powers = st.tuples(*[st.floats(0.15, 1.25)] * 2)


@given(axes, inner_powers, turns, places, st.integers(0, 99))
@settings(max_examples=40, deadline=None)
def test_jacobians_agree_with_finite_differences(half, exponents, turn, place, seed):
    solids = solids_of(half, exponents, turn, place)
    rng = np.random.default_rng(seed)
    # away from the planes of symmetry, where powers below 2 have kinks that differences cannot follow
    unit = rng.uniform(0.15, 1.0, (3, 20)) * rng.choice([-1.0, 1.0], (3, 20))
    points = rotation_exp(turn) @ (unit / np.abs(unit).max(axis=0) * np.array(half)[:, None] * 1.1)
    points += np.array(place)[:, None]
    rows = columns(points.T, np.array([0.2, -0.3, -1.0]) / np.linalg.norm([0.2, -0.3, -1.0]))
    values = evaluate(solids, rows, True)
    np.testing.assert_allclose(values.J_gauge, evaluate(solids, rows[:, :-1], False).J_gauge, rtol=1e-12, atol=1e-15)
    by_points = numerical(lambda s: evaluate(s, rows, True).gauge[0], solids)
    np.testing.assert_allclose(values.J_gauge[0].T, by_points, rtol=2e-4, atol=2e-4 / min(half))
    by_reach = numerical(lambda s: evaluate(s, rows, True).reach[0], solids)
    np.testing.assert_allclose(values.J_reach[0], by_reach, rtol=2e-4, atol=2e-6)


def log_outline(solids: Solids, view: np.ndarray) -> float:
    """Log area of a box's outline: each visible face counts with its cosine."""
    a, b, c = solids.half[0]
    return np.log(np.abs(solids.R[0].T @ view) @ [b * c, a * c, a * b])


@given(axes, inner_powers, turns)
@settings(max_examples=30, deadline=None)
def test_outline_agrees_with_its_area_and_with_finite_differences(half, exponents, turn):
    solids = solids_of(half, exponents, turn, (0.0, 0.0, 0.0))
    view = rotation_exp(turn) @ np.array([0.5, -0.4, 0.75])  # away from the kinks at the faces' edges
    assert outline(solids, view[None])[0] == pytest.approx(log_outline(solids, view))
    np.testing.assert_allclose(
        outline_jacobian(solids, view[None])[0], numerical(lambda s: log_outline(s, view), solids), atol=1e-5
    )


def test_viewer_of_a_box_follows_from_its_mean_visible_normal():
    half, view = np.array([0.02, 0.05, 0.08]), np.array([0.4, 0.5, 0.77])
    faces = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
    mean_normal = view * faces / (view * faces).sum()  # each face weighs with its area in the image
    found = viewers(solids_of(half, (0.05, 0.05), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), mean_normal[None])[0]
    np.testing.assert_allclose(found / np.linalg.norm(found), view / np.linalg.norm(view), atol=1e-9)


@given(turns)
@settings(deadline=None)
def test_small_steps_turn_as_the_exponential_map(turn):
    w = 0.05 * np.array(turn)
    R = rotations(w[None])[0]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.abs(R - rotation_exp(w)).max() < 0.1 * np.linalg.norm(w) ** 3 + 1e-12
