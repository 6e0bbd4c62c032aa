"""From the network's outputs to hand poses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from icub_core.geometry import is_rigid
from icub_grasp_generators.planned_hand import planned_hand
from icub_grasp_generators.vgn.adaptation import hand_poses
from icub_grasp_generators.vgn.palm import PALM_POINT, at_palm, from_palm
from icub_grasp_generators.vgn.selection import Selected, near_surface, select
from icub_grasp_generators.vgn.volume import Volume
from icub_robots.icub import ICub

SHAPE = (40, 40, 40)
RIGHT = planned_hand(ICub().description)


@pytest.fixture
def outputs():
    """A wall at x = 20 seen from +x, and quality nowhere."""
    x = np.arange(40)[:, None, None] * np.ones(SHAPE)
    distance = (x - 20) / 4
    tsdf = np.where(np.abs(distance) < 0.98, (distance + 1) / 2, 0.0).astype(np.float32)
    rotation = np.zeros((4, *SHAPE), dtype=np.float32)
    rotation[3] = 1.0
    return tsdf, np.zeros(SHAPE, dtype=np.float32), rotation, np.full(SHAPE, 5.0, dtype=np.float32)


def blob(quality, at, height):
    i, j, k = at
    quality[i - 2 : i + 3, j - 2 : j + 3, k - 2 : k + 3] = height


def test_the_best_first_and_none_beside_a_better_one(outputs):
    tsdf, quality, rotation, width = outputs
    blob(quality, (22, 10, 10), 0.8)
    blob(quality, (22, 30, 20), 1.0)
    found = select(tsdf, quality, rotation, width, threshold=0.7)
    np.testing.assert_array_equal(found.index[0], [22, 30, 20])
    assert 1.0 > found.quality[0] > 0.9
    assert np.all(np.diff(found.quality) <= 0)
    assert found.quality[-1] >= 0.7
    np.testing.assert_array_equal(found.quaternion[0], [0, 0, 0, 1])
    apart = np.abs(found.index[:, None] - found.index[None]).max(axis=2)
    assert apart[~np.eye(len(apart), dtype=bool)].min() > 2
    assert any(np.array_equal(index, [22, 10, 10]) for index in found.index)
    assert len(select(tsdf, quality, rotation, width, threshold=0.9).index) == 1


def test_a_wide_region_gives_many_grasps_all_over_it(outputs):
    tsdf, quality, rotation, width = outputs
    quality[20:26, 5:35, 5:35] = 0.9
    index = select(tsdf, quality, rotation, width, threshold=0.5).index
    assert len(index) == 64
    assert np.ptp(index[:, 1]) > 15


def test_smoothing_takes_a_lonely_voxel_away(outputs):
    tsdf, quality, rotation, width = outputs
    quality[22, 10, 10] = 1.0
    assert len(select(tsdf, quality, rotation, width, threshold=0.5).index) == 0


@pytest.mark.parametrize("at", [(15, 20, 20), (34, 20, 20), (5, 20, 20)])
def test_no_grasp_behind_the_surface_or_far_from_it(outputs, at):
    tsdf, quality, rotation, width = outputs
    blob(quality, at, 1.0)
    assert len(select(tsdf, quality, rotation, width, threshold=0.5).index) == 0


def test_where_a_grasp_may_be(outputs):
    allowed = np.flatnonzero(near_surface(outputs[0])[:, 20, 20])
    np.testing.assert_array_equal(allowed, np.arange(20, 26))  # the wall itself, measured outside to 23, two more


@pytest.mark.parametrize(("opening", "kept"), [(0.5, 0), (2.0, 1), (9.0, 1), (10.0, 0)])
def test_openings_that_the_gripper_has(outputs, opening, kept):
    tsdf, quality, rotation, width = outputs
    blob(quality, (22, 10, 10), 1.0)
    width[:] = opening
    assert len(select(tsdf, quality, rotation, width, threshold=0.5).index) == kept
    assert len(select(tsdf, quality, rotation, width, threshold=0.5, widths=None).index) == 1


def test_inputs_are_not_changed(outputs):
    tsdf, quality, rotation, width = outputs
    blob(quality, (22, 10, 10), 0.8)
    before = quality.copy()
    select(tsdf, quality, rotation, width, threshold=0.9)
    np.testing.assert_array_equal(quality, before)


quaternions = st.tuples(*4 * [st.floats(-1, 1)]).filter(lambda q: np.linalg.norm(q) > 0.1)


def found(quaternion) -> Selected:
    unit = np.array(quaternion) / np.linalg.norm(quaternion)
    return Selected(np.array([[20, 11, 7]]), np.array([0.9]), unit[None], np.array([5.0]))


@given(quaternions)
def test_the_hand_takes_in_along_the_approach_and_closes_along_the_gripper_s_opening(quaternion):
    volume = Volume(np.array([-0.5, -0.15, 0.9]))
    poses, quality = hand_poses(found(quaternion), volume, "gripper", RIGHT)
    gripper = Rotation.from_quat(quaternion).as_matrix()
    np.testing.assert_array_equal(quality, [0.9, 0.9])
    for T in poses:
        assert is_rigid(T)
        x, z = T[:3, 0], T[:3, 2]
        np.testing.assert_allclose((x + z) / np.sqrt(2), gripper[:, 2], atol=1e-9)
        assert abs((x - z) / np.sqrt(2) @ gripper[:, 1]) == pytest.approx(1.0)
        np.testing.assert_allclose(T[:3, 3], volume.point_of(np.array([20, 11, 7])))
    # mirrored candidates: fingers and thumb change sides
    np.testing.assert_allclose(poses[0][:3, 1], -poses[1][:3, 1], atol=1e-9)


@given(quaternions)
def test_a_hand_s_voxel_is_its_palm_point(quaternion):
    volume = Volume(np.array([-0.5, -0.15, 0.9]))
    (T,), _ = hand_poses(found(quaternion), volume, "hand", RIGHT)
    np.testing.assert_allclose(T[:3, :3] @ PALM_POINT + T[:3, 3], volume.point_of(np.array([20, 11, 7])), atol=1e-9)
    np.testing.assert_allclose(from_palm(at_palm(T[None]))[0], T, atol=1e-12)


@pytest.mark.parametrize("pose", ["gripper", "hand"])
def test_nothing_found_gives_no_poses(pose):
    nothing = Selected(np.zeros((0, 3), dtype=np.intp), np.zeros(0), np.zeros((0, 4)), np.zeros(0))
    poses, quality = hand_poses(nothing, Volume(np.zeros(3)), pose, RIGHT)
    assert poses.shape == (0, 4, 4)
    assert len(quality) == 0
