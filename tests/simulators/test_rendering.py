"""What every engine promises of its images."""

import numpy as np
import pytest

from icub_core.errors import SimulationError
from icub_core.geometry import look_at, make_transform
from icub_core.scene import CameraView, Light, Material, Scene

OVERHEAD = CameraView(look_at([-0.35, 0.0, 1.75], [-0.35, 0.0, 0.95], up=(1.0, 0.0, 0.0)), fovy=0.6)


@pytest.fixture(scope="module")
def still(world, ycb, standing):
    """The world with the sugar box standing in view and the can parked."""
    world.reset()
    world.set_object_pose("004_sugar_box", standing(ycb.get("004_sugar_box")))
    return world


def test_depth_of_a_box_is_right_to_a_millimetre(still):
    rendering = still.render(OVERHEAD, 320, 240, segmentation=True)
    box = rendering.segmentation == 0
    assert box.sum() > 500
    inside = box & np.roll(box, 2, 0) & np.roll(box, -2, 0) & np.roll(box, 2, 1) & np.roll(box, -2, 1)
    np.testing.assert_allclose(rendering.frame.depth[inside], 1.75 - 0.95 - 0.089, atol=1e-3)


def test_the_cloud_of_a_box_lies_on_its_top_face(still):
    """Back-projection with the stated intrinsics meets the true edges: pixel centers have whole coordinates."""
    rendering = still.render(OVERHEAD, 640, 480, segmentation=True)
    points = rendering.frame.to_cloud(rendering.segmentation == 0).points
    pixel = 0.711 / rendering.frame.intrinsics[0, 0]
    top = points[points[:, 2] > 1.03]
    np.testing.assert_allclose(top[:, :2].max(axis=0), [-0.35 + 0.019, 0.0875], atol=1.0 * pixel)
    np.testing.assert_allclose(top[:, :2].min(axis=0), [-0.35 - 0.019, -0.0875], atol=1.0 * pixel)


def test_image_is_not_mirrored(still, ycb, standing):
    """Seen from above with world x upwards, an object at +y is on the left."""
    still.set_object_pose("005_tomato_soup_can", standing(ycb.get("005_tomato_soup_can"), y=0.15))
    seen = still.render(OVERHEAD, 320, 240, segmentation=True).segmentation
    still.park_object("005_tomato_soup_can")
    assert np.nonzero(seen == 1)[1].mean() < np.nonzero(seen == 0)[1].mean() - 30


def test_segmentation_names_objects_and_nothing_else(still):
    seen = still.render(OVERHEAD, 160, 120, segmentation=True).segmentation
    assert set(np.unique(seen)) == {-1, 0}  # the can is parked; table and robot are none
    assert still.render(OVERHEAD, 160, 120).segmentation is None


def test_an_object_covers_the_pixels_where_it_changes_the_image(still):
    with_box = still.render(OVERHEAD, 160, 120, segmentation=True)
    pose = still.object_pose("004_sugar_box")
    still.park_object("004_sugar_box")
    without = still.render(OVERHEAD, 160, 120)
    still.set_object_pose("004_sugar_box", pose)
    changed = np.abs(with_box.frame.depth - without.frame.depth) > 1e-3
    assert np.mean(changed != (with_box.segmentation == 0)) < 0.005


def test_the_same_image_twice(still):
    first, second = (still.render("head_cam", 160, 120, segmentation=True) for _ in range(2))
    np.testing.assert_array_equal(first.frame.rgb, second.frame.rgb)
    np.testing.assert_array_equal(first.frame.depth, second.frame.depth)
    np.testing.assert_array_equal(first.segmentation, second.segmentation)


def test_a_image_does_not_change_the_future(still):
    state = still.save_state()
    still.step(20)
    end = still.save_state()
    still.restore_state(state)
    still.render("head_cam", 64, 48)
    still.step(20)
    np.testing.assert_array_equal(still.save_state(), end)
    still.restore_state(state)


def test_a_image_shows_the_present(still):
    """Also right after a teleport, before any step."""
    state = still.save_state()
    still.set_object_pose("004_sugar_box", make_transform(None, [-0.35, 0.0, 1.3]))
    assert still.render(OVERHEAD, 160, 120).frame.depth[60, 80] == pytest.approx(1.75 - 1.3 - 0.0875, abs=1e-3)
    still.restore_state(state)


def test_a_tracking_camera_has_its_target_in_the_middle(still):
    target = still.object_pose("004_sugar_box")[:3, 3]
    rendering = still.render("head_cam", 160, 120, look_at=target, segmentation=True)
    rows, columns = np.nonzero(rendering.segmentation == 0)
    assert abs(columns.mean() - 79.5) < 6
    assert abs(rows.mean() - 59.5) < 6
    axis = rendering.frame.T_world_camera[:3, 2]
    toward = target - rendering.frame.T_world_camera[:3, 3]
    np.testing.assert_allclose(axis, toward / np.linalg.norm(toward), atol=1e-9)


def test_a_named_camera_rides_on_its_link(still, icub):
    d = icub.description
    before = still.render("head_cam", 32, 24).frame.T_world_camera
    q = d.home_q
    q[d.joint_names.index("neck_yaw")] += 0.3
    state = still.save_state()
    still.set_joint_positions(q)
    after = still.render("head_cam", 32, 24).frame.T_world_camera
    still.restore_state(state)
    head = icub.forward_kinematics(q, "head") @ np.linalg.inv(icub.forward_kinematics(d.home_q, "head"))
    np.testing.assert_allclose(after, head @ before, atol=1e-6)


def test_the_robot_is_in_the_image(still):
    front = CameraView(look_at([-1.5, 0.0, 1.4], [0.0, 0.0, 1.2]), 0.9)
    depth = still.render(front, 160, 120).frame.depth
    chest = depth[60, 80]
    assert 1.2 < chest < 1.7


@pytest.mark.parametrize("size", [(1, 1), (33, 17), (900, 700)])
def test_any_size(still, size):
    rendering = still.render(OVERHEAD, *size)
    assert rendering.frame.rgb.shape == (size[1], size[0], 3)
    assert np.isfinite(rendering.frame.depth).all()


def test_a_size_that_cannot_be_is_one_line(still):
    with pytest.raises(SimulationError, match="0 x 120"):
        still.render(OVERHEAD, 0, 120)


def test_shadows_change_colors_but_not_geometry(still):
    plain = still.render(OVERHEAD, 160, 120, segmentation=True)
    pretty = still.render(OVERHEAD, 160, 120, segmentation=True, shadows=True)
    np.testing.assert_array_equal(plain.segmentation, pretty.segmentation)
    assert np.abs(plain.frame.rgb.astype(int) - pretty.frame.rgb).max() > 20


def test_looks_can_be_changed_at_any_time(engine, ycb, standing):
    engine.load(None, Scene(objects=(ycb.get("004_sugar_box"),)))
    engine.set_object_pose("004_sugar_box", standing(ycb.get("004_sugar_box")))
    before = engine.render(OVERHEAD, 160, 120, segmentation=True)
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[..., 1] = 255
    engine.set_appearance(table=Material((1.0, 1.0, 1.0, 1.0), texture, specular=0.0))
    after = engine.render(OVERHEAD, 160, 120, segmentation=True)
    table = before.segmentation == -1
    assert after.frame.rgb[table][:, 1].mean() > 3 * after.frame.rgb[table][:, [0, 2]].mean()
    np.testing.assert_array_equal(after.frame.rgb[~table], before.frame.rgb[~table])
    engine.set_appearance(lights=(Light(diffuse=(0.05, 0.05, 0.05), ambient=(0.05, 0.05, 0.05)),))
    dark = engine.render(OVERHEAD, 160, 120)
    assert dark.frame.rgb.mean() < 0.5 * after.frame.rgb.mean()
    engine.load(None, Scene(table=None))
    with pytest.raises(SimulationError, match="table"):
        engine.set_appearance(table=Material())


def test_every_ycb_object_has_its_own_look(engine, ycb, standing):
    engine.load(None, Scene(objects=tuple(ycb.get(n) for n in ycb.names)))
    means = []
    for number, name in enumerate(ycb.names):
        engine.reset()
        engine.set_object_pose(name, standing(ycb.get(name)))
        view = CameraView(look_at([0.2, 0.1, 1.4], [-0.35, 0.0, 1.02]), 0.5)
        rendering = engine.render(view, 160, 120, segmentation=True)
        pixels = rendering.frame.rgb[rendering.segmentation == number]
        assert len(pixels) > 200, name
        assert pixels.std(axis=0).max() > 12, f"{name} has no print"
        means.append(pixels.mean(axis=0))
    distances = np.linalg.norm(np.array(means)[:, None] - np.array(means)[None], axis=2)
    assert distances[np.triu_indices(len(means), 1)].min() > 10
