"""Rigid transforms: round trips, and the conventions that the docstrings state, against scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from icub_core.geometry import (
    invert,
    is_rigid,
    look_at,
    make_transform,
    matrix_to_quat_wxyz,
    matrix_to_rpy,
    pinhole,
    quat_wxyz_to_matrix,
    rotation_about,
    rotation_exp,
    rotation_log,
    rpy_to_matrix,
)

angles = st.floats(-np.pi, np.pi)
vectors = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)


@given(st.tuples(angles, angles, angles))
def test_rpy_is_the_urdf_convention_and_inverts(rpy):
    R = rpy_to_matrix(rpy)
    assert np.allclose(R, Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-12)
    assert np.allclose(rpy_to_matrix(matrix_to_rpy(R)), R, atol=1e-7)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
@given(roll=angles, yaw=angles)
def test_rpy_inverts_at_the_singularity(pitch, roll, yaw):
    R = rpy_to_matrix((roll, pitch, yaw))
    assert np.allclose(rpy_to_matrix(matrix_to_rpy(R)), R, atol=1e-7)


@given(vectors)
def test_exponential_logarithm_and_quaternion_agree_with_scipy(vector):
    R = rotation_exp(vector)
    reference = Rotation.from_rotvec(vector)
    assert np.allclose(R, reference.as_matrix(), atol=1e-12)
    assert np.allclose(rotation_log(R), reference.as_rotvec(), atol=1e-7)
    assert np.allclose(quat_wxyz_to_matrix(matrix_to_quat_wxyz(R)), R, atol=1e-12)


@given(vectors, vectors)
def test_inverse_and_rigidity(vector, translation):
    T = make_transform(rotation_exp(vector), translation)
    assert is_rigid(T)
    assert np.allclose(invert(T) @ T, np.eye(4), atol=1e-12)
    for spoiled in (T * 1.01, np.diag([1.0, 1.0, -1.0, 1.0]) @ T, np.full((4, 4), np.nan), T[:3]):
        assert not is_rigid(spoiled)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_rotation_about_turns_right_handed(axis):
    assert np.allclose(rotation_about(axis, 0.3), Rotation.from_euler(axis, 0.3).as_matrix(), atol=1e-12)


@given(vectors, vectors)
def test_a_camera_that_looks_at_a_point_sees_it_in_the_middle_and_upright(eye, target):
    line = target - eye
    if np.linalg.norm(line) < 0.1 or np.linalg.norm(line[:2]) < 0.01:
        return
    T = look_at(eye, target)
    assert is_rigid(T)
    x, y, z = (invert(T) @ np.append(target, 1.0))[:3]
    assert np.allclose([x, y], 0.0, atol=1e-9)
    assert z == pytest.approx(np.linalg.norm(line))
    assert T[2, 1] < 0  # the image's y axis points down in the world
    assert abs(T[2, 0]) < 1e-9  # no roll


def test_pinhole_of_the_head_camera_is_the_published_one():
    K = pinhole(640, 480, np.deg2rad(42.4608673))
    # published with pixel corners at whole numbers; here whole numbers are pixel centers
    assert np.allclose(K, [[617.783, 0, 320 - 0.5], [0, 617.783, 240 - 0.5], [0, 0, 1]], atol=1e-2)
