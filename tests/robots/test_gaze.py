"""Gaze: the least turn of the neck that brings a point near the optical axis, or an honest no."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from icub_core.errors import ConfigError, DataError
from icub_core.geometry import make_transform, quat_wxyz_to_matrix
from icub_robots.icub import ICub

ROBOT = ICub()
D = ROBOT.description
NECK = D.indices("neck")
CAMERA = D.cameras[0]
TOLERANCE = np.arccos(0.99)


def angle_to(q, point):
    T = ROBOT.forward_kinematics(q, CAMERA.link)
    T = T @ make_transform(quat_wxyz_to_matrix(CAMERA.quat_wxyz), CAMERA.position)
    line = point - T[:3, 3]
    return np.arccos(np.clip(T[:3, 2] @ line / np.linalg.norm(line), -1, 1))


@settings(max_examples=25, deadline=None)
@given(st.tuples(st.floats(-1.2, 0.3), st.floats(-0.8, 0.8), st.floats(0.5, 1.6)))
def test_answers_are_true_and_only_the_neck_moves(point):
    point = np.array(point)
    solution = ROBOT.gaze(point, D.home_q)
    assert solution.angle == pytest.approx(angle_to(solution.q, point), abs=1e-6)
    assert solution.reached == (solution.angle <= TOLERANCE + 1e-5)
    assert np.all(solution.q >= D.lower)
    assert np.all(solution.q <= D.upper)
    others = np.setdiff1d(np.arange(len(solution.q)), NECK)
    assert np.array_equal(solution.q[others], D.home_q[others])


@pytest.mark.parametrize("point", [(-0.4, 0.0, 1.0), (-0.6, 0.3, 1.0), (-0.6, -0.3, 1.2), (-1.0, 0.1, 1.3)])
def test_the_turn_is_as_small_as_the_published_solver_finds(point):
    """COBYLA on the same problem, as the released gaze controller does it."""
    point, rest = np.array(point), D.home_q[NECK]

    def slack(neck):
        q = D.home_q
        q[NECK] = neck
        return np.cos(angle_to(q, point)) - 0.99

    bounds = [{"type": "ineq", "fun": lambda n, i=i, j=j: n[i] - D.lower[j]} for i, j in enumerate(NECK)]
    bounds += [{"type": "ineq", "fun": lambda n, i=i, j=j: D.upper[j] - n[i]} for i, j in enumerate(NECK)]
    reference = minimize(
        lambda n: np.sum((n - rest) ** 2),
        rest,
        method="COBYLA",
        constraints=[*bounds, {"type": "ineq", "fun": slack}],
        options={"maxiter": 2000, "rhobeg": 0.1},
    )
    assert slack(reference.x) > -1e-3
    solution = ROBOT.gaze(point, D.home_q)
    assert solution.reached
    assert np.sum((solution.q[NECK] - rest) ** 2) <= reference.fun + 2e-3


def test_a_point_that_is_seen_already_needs_no_turn():
    T = ROBOT.forward_kinematics(D.home_q, CAMERA.link)
    T = T @ make_transform(quat_wxyz_to_matrix(CAMERA.quat_wxyz), CAMERA.position)
    solution = ROBOT.gaze(T[:3, 3] + 0.6 * T[:3, 2], D.home_q)
    assert solution.reached
    assert np.allclose(solution.q, D.home_q, atol=1e-3)


def test_a_point_behind_the_robot_is_not_reached():
    solution = ROBOT.gaze(np.array([1.5, 0.0, 1.4]), D.home_q)
    assert not solution.reached
    assert solution.angle > 0.5


def test_wrong_inputs_are_named():
    with pytest.raises(ConfigError, match="Did you mean 'head_cam'"):
        ROBOT.gaze(np.zeros(3), D.home_q, camera="headcam")
    with pytest.raises(ConfigError, match="front_cam.*does not move with the neck"):
        ROBOT.gaze(np.zeros(3), D.home_q, camera="front_cam")
    with pytest.raises(DataError, match="3 finite coordinates"):
        ROBOT.gaze(np.array([np.nan, 0, 0]), D.home_q)
