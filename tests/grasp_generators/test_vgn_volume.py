"""The signed distance field of `vgn` against rays cut with spheres and planes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from icub_core.data import PointCloud, RgbdFrame
from icub_core.errors import DataError
from icub_core.geometry import look_at
from icub_grasp_generators.vgn.volume import RESOLUTION, SIZE, TRUNCATION, VOXEL, Volume

CENTER, RADIUS, TOP = np.array([-0.35, 0.02, 1.02]), 0.07, 0.95
FRONT = np.array([-0.1, 0.05, 1.5])
VOLUME = Volume.around(CENTER, TOP)


def first_hit(eye, directions):
    """Distance (N,) along unit rays to the sphere; infinite where they miss it."""
    along = directions @ (CENTER - eye)
    aside = np.sum((CENTER - eye) ** 2) - along**2
    return np.where(aside < RADIUS**2, along - np.sqrt(np.maximum(RADIUS**2 - aside, 0.0)), np.inf)


def sphere_seen_from(eye, pixels: int = 150) -> PointCloud:
    line = np.linspace(-0.35, 0.35, pixels)
    x, y = np.meshgrid(line, line)
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1) @ look_at(eye, CENTER)[:3, :3].T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance = first_hit(eye, rays)
    hit = np.isfinite(distance)
    return PointCloud(eye + distance[hit, None] * rays[hit], viewpoint=eye)


def voxel_centers():
    grid = np.stack(np.meshgrid(*3 * [np.arange(RESOLUTION)], indexing="ij"), axis=-1)
    return VOLUME.origin + (grid + 0.5) * VOXEL


def along_the_ray(eye):
    """Exact distance of every voxel to the sphere along its ray, and how squarely the ray meets it."""
    to = voxel_centers() - eye
    own = np.linalg.norm(to, axis=-1)
    hit = first_hit(eye, (to / own[..., None]).reshape(-1, 3)).reshape(own.shape)
    point = eye + to / own[..., None] * np.where(np.isfinite(hit), hit, 0.0)[..., None]
    square = np.abs(np.einsum("...i,...i->...", (point - CENTER) / RADIUS, to / own[..., None]))
    return hit - own, np.where(np.isfinite(hit), square, 0.0)


@pytest.mark.parametrize("pixels", [60, 150])
def test_one_view_of_a_sphere(pixels):
    field = VOLUME.tsdf((sphere_seen_from(FRONT, pixels),))
    distance, square = along_the_ray(FRONT)
    certain = square > 0.85  # away from the outline, where one pixel decides between sphere and nothing
    band = certain & (np.abs(distance) < 0.9 * TRUNCATION)
    expected = (distance / TRUNCATION + 1) / 2
    assert band.sum() > 400
    np.testing.assert_allclose(field[band], expected[band], atol=0.06)  # 3.6 mm, half a voxel
    slanted = (square > 0.5) & (np.abs(distance) < 0.9 * TRUNCATION)
    assert np.median(np.abs(field[slanted] - expected[slanted])) < 0.02
    assert np.all(field[certain & (distance < -1.05 * TRUNCATION)] == 0)  # hidden
    assert np.all(field[certain & (distance > 1.05 * TRUNCATION)] == 0)  # free
    assert np.all((field >= 0) & (field < 1))


def test_the_sign_and_size_are_those_of_the_true_distance_where_the_view_is_square():
    field = VOLUME.tsdf((sphere_seen_from(FRONT),))
    true = np.linalg.norm(voxel_centers() - CENTER, axis=-1) - RADIUS
    _, square = along_the_ray(FRONT)
    facing = (voxel_centers() - CENTER) @ (FRONT - CENTER) > 0
    band = facing & (square > 0.97) & (np.abs(true) < 0.8 * TRUNCATION)
    assert band.sum() > 50
    np.testing.assert_allclose(field[band], (true[band] / TRUNCATION + 1) / 2, atol=0.05)


def test_further_views_show_the_other_side():
    back = 2 * CENTER - FRONT
    one = VOLUME.tsdf((sphere_seen_from(FRONT),))
    both = VOLUME.tsdf((sphere_seen_from(FRONT), sphere_seen_from(back)))
    assert (both > 0).sum() > 1.5 * (one > 0).sum()
    far_side = (voxel_centers() - CENTER) @ (FRONT - CENTER) < -0.3 * RADIUS
    assert (one[far_side] > 0.5).sum() < 0.2 * (both[far_side] > 0.5).sum()


def test_order_of_views_does_not_matter():
    views = (sphere_seen_from(FRONT), sphere_seen_from(np.array([-0.3, 0.5, 1.4])))
    np.testing.assert_allclose(VOLUME.tsdf(views), VOLUME.tsdf(views[::-1]), atol=1e-6)


def test_the_table_is_in_the_field_only_when_asked_for_and_never_before_the_object():
    view = sphere_seen_from(FRONT)
    without, with_it = VOLUME.tsdf((view,)), VOLUME.tsdf((view,), TOP)
    corner = with_it[2, 2]  # far from sphere and shadow
    assert np.all(without[2, 2] == 0)
    eye_to = voxel_centers()[2, 2] - FRONT
    down = eye_to[:, 2] / np.linalg.norm(eye_to, axis=1)
    expected = ((TOP - FRONT[2]) / down - np.linalg.norm(eye_to, axis=1)) / TRUNCATION
    near = np.abs(expected) < 0.95
    assert near.sum() >= 4
    np.testing.assert_allclose(corner[near], (expected[near] + 1) / 2, atol=1e-3)
    _, square = along_the_ray(FRONT)
    np.testing.assert_array_equal(with_it[square > 0.3], without[square > 0.3])


def test_no_points_no_surface():
    assert not VOLUME.tsdf((PointCloud(np.zeros((0, 3)), viewpoint=FRONT),)).any()


@pytest.mark.parametrize(
    ("views", "part"),
    [
        ((), "at least one view"),
        ((PointCloud(np.zeros((9, 3))),), "viewpoint"),
        ((PointCloud(np.zeros((9, 3)), viewpoint=CENTER),), "viewpoint is 0."),
    ],
)
def test_what_has_no_field(views, part):
    with pytest.raises(DataError, match=part):
        VOLUME.tsdf(views)


@given(st.tuples(*3 * [st.integers(0, RESOLUTION - 1)]), st.tuples(*3 * [st.floats(-2, 2)]))
def test_voxels_and_points(index, origin):
    volume = Volume(np.array(origin))
    point = volume.point_of(np.array(index))
    assert np.all(point >= volume.origin)
    assert np.all(point < volume.origin + SIZE)
    np.testing.assert_array_equal(volume.index_of(point), index)
    np.testing.assert_array_equal(volume.index_of(point + 0.49 * VOXEL), index)


def test_a_cloud_knows_where_its_camera_stood():
    T = look_at(FRONT, CENTER)
    depth = np.full((4, 6), 0.5, dtype=np.float32)
    frame = RgbdFrame(np.zeros((4, 6, 3), np.uint8), depth, np.array([[50.0, 0, 2.5], [0, 50, 1.5], [0, 0, 1]]), T)
    np.testing.assert_array_equal(frame.to_cloud().viewpoint, FRONT)
    with pytest.raises(DataError, match="viewpoint is"):
        PointCloud(np.zeros((2, 3)), viewpoint=np.zeros(2))
