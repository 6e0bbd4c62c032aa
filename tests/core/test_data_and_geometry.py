import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from icub_core import geometry
from icub_core.data import Grasp, Instance, PointCloud, RgbdFrame
from icub_core.errors import DataError

vectors = st.lists(st.floats(-3, 3), min_size=3, max_size=3).map(np.array)


@given(vectors)
def test_rotation_exp_and_log_agree_with_scipy(v):
    R = geometry.rotation_exp(v)
    np.testing.assert_allclose(R, Rotation.from_rotvec(v).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(geometry.rotation_exp(geometry.rotation_log(R)), R, atol=1e-9)


@given(vectors)
def test_quaternions_are_wxyz_and_round_trip(v):
    R = Rotation.from_rotvec(v).as_matrix()
    quat = geometry.matrix_to_quat_wxyz(R)
    np.testing.assert_allclose(geometry.quat_wxyz_to_matrix(quat), R, atol=1e-12)
    x, y, z, w = Rotation.from_matrix(R).as_quat()
    np.testing.assert_allclose(abs(np.dot(quat, [w, x, y, z])), 1, atol=1e-12)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_half_turns_are_exact(axis):
    R = geometry.rotation_about(axis, np.pi)
    np.testing.assert_allclose(np.linalg.norm(geometry.rotation_log(R)), np.pi)
    np.testing.assert_allclose(R, Rotation.from_euler(axis, np.pi).as_matrix(), atol=1e-15)


@given(vectors, vectors)
def test_invert_undoes_a_transform(v, t):
    T = geometry.make_transform(geometry.rotation_exp(v), t)
    np.testing.assert_allclose(geometry.invert(T) @ T, np.eye(4), atol=1e-12)


def test_a_point_in_front_of_the_camera_projects_where_it_was_seen():
    T_world_camera = geometry.look_at([0.3, -0.2, 1.0], [0.0, 0.1, 0.4])
    intrinsics = geometry.pinhole(320, 240, 0.74)
    depth = np.zeros((240, 320), np.float32)
    depth[100, 210] = 0.7
    frame = RgbdFrame(np.zeros((240, 320, 3), np.uint8), depth, intrinsics, T_world_camera)
    point = frame.to_cloud().points[0]
    in_camera = geometry.invert(T_world_camera) @ [*point, 1]
    pixel = intrinsics @ in_camera[:3] / in_camera[2]
    np.testing.assert_allclose(pixel[:2], [210, 100], atol=1e-5)
    np.testing.assert_allclose(in_camera[2], 0.7, atol=1e-6)


def test_look_at_keeps_the_image_upright():
    T = geometry.look_at([1.0, 0.0, 1.0], [0.0, 0.0, 0.0])
    assert geometry.is_rigid(T)
    assert T[2, 1] < 0  # the camera's y axis points down in the world


def test_backing_off_moves_along_the_line_from_center_to_hand():
    T = geometry.make_transform(translation=[0.1, 0.0, 0.2])
    grasp = Grasp(T, np.array([0.1, 0.0, 0.1]), 1.0, "test")
    np.testing.assert_allclose(grasp.backed_off(0.05)[:3, 3], [0.1, 0.0, 0.25])
    np.testing.assert_allclose(T[:3, 3], [0.1, 0.0, 0.2])


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: PointCloud(np.zeros((3, 2))), r"\(N, 3\)"),
        (lambda: Grasp(np.diag([1.0, 1, -1, 1]), np.zeros(3), 1.0, "x"), "rigid"),
        (lambda: Grasp(np.eye(4), np.zeros(3), 1.0, "x", hand=""), "Grasp.hand is empty"),
        (lambda: Instance.from_mask("mug", np.zeros((4, 4), bool)), "mug"),
        (lambda: RgbdFrame(np.zeros((4, 4, 3)), np.zeros((4, 4), np.float32), np.eye(3), np.eye(4)), "uint8"),
        (lambda: RgbdFrame(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 5), np.float32), np.eye(3), np.eye(4)), "depth"),
    ],
)
def test_wrong_data_is_named_in_one_line(make, named):
    with pytest.raises(DataError, match=named) as caught:
        make()
    assert "\n" not in str(caught.value)
