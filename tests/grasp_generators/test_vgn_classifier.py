"""The grasp-quality classifier: what it sees moves with the hand, what it learns, and the poses it is asked about."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from icub_core.data import PointCloud
from icub_core.errors import DataError, WeightsError
from icub_core.geometry import is_rigid, make_transform, quat_wxyz_to_matrix, rotation_about
from icub_grasp_generators.synthetic_clouds import surface
from icub_grasp_generators.vgn.classifier import CELLS, GraspClassifier, around_hand, facts_of, heights
from icub_grasp_generators.vgn.classifier_training import evaluate_classifier, fit_classifier
from icub_grasp_generators.vgn.exploration import DIP, ROLL, draw_poses, fitted, gripped_share
from icub_grasp_generators.vgn.hand_search import around
from icub_grasp_generators.vgn.network import HAND, Meaning, VgnNetwork, load_network, save_network
from icub_grasp_generators.vgn.palm import PALM_POINT, YAW, at_palm
from icub_grasp_generators.vgn.range_view import RangeView
from icub_grasp_generators.vgn.trial_objects import MASS, SHAPES, TrialObjects, random_shape
from icub_grasp_generators.vgn.trials import TriedScene

HALF = np.array([0.025, 0.04, 0.06])
TOP = 0.95
CENTER = np.array([-0.35, 0.0, TOP + HALF[2]])
EYE = np.array([-0.185, -0.044, 1.393])
FROM_ABOVE = make_transform(rotation_about("z", np.pi) @ np.diag([1.0, -1.0, -1.0]), CENTER + [0.03, 0.0, 0.065])
"""x of the hand across the box, the palm 5 mm above it."""


def box(half=HALF) -> PointCloud:
    points, normals = surface("box", np.asarray(half), np.random.default_rng(0), 8000)
    points = points + [CENTER[0], CENTER[1], TOP + half[2]]
    return PointCloud(points[np.sum(normals * (EYE - points), axis=1) > 0], viewpoint=EYE)


def view_of(cloud: PointCloud) -> RangeView:
    return RangeView(cloud, CENTER, 0.27)


def test_free_before_the_surface_hidden_behind_it():
    towards = (EYE - CENTER) / np.linalg.norm(EYE - CENTER)
    points = np.array([CENTER + 0.17 * towards, CENTER, CENTER + [0.3, 0.0, 0.0]])
    before, behind, beside = view_of(box()).distance(points)
    assert before - behind == pytest.approx(0.17, abs=0.01)  # a pixel is 4 mm
    assert behind < -0.04
    assert before > 0.08
    assert beside == np.inf
    top = view_of(box()).distance(CENTER[None] + [0.12, 0.0, 0.0], table_top=TOP)
    assert 0 < top[0] < 0.12  # the ray ends on the table, 6 cm below
    with pytest.raises(DataError, match="viewpoint is"):
        RangeView(PointCloud(CENTER[None], viewpoint=CENTER + 0.1), CENTER, 0.27)


def test_the_grid_shows_the_object_before_the_palm():
    (grid,) = around_hand(view_of(box()), FROM_ABOVE[None])
    assert grid.shape == CELLS
    assert grid.min() == -1
    assert grid.max() == 1
    inside = grid < 0
    assert not inside[:, :, :4].any()  # nothing behind the palm (z below 0)
    wide = np.flatnonzero(inside[:, 7, 6])  # a row along the fingers, 2.5 cm before the palm
    assert 4 <= len(wide) <= 8  # 5 cm, and what the box hides beside it


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.5, 0.5), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_what_the_classifier_sees_does_not_change_when_hand_and_scene_move_together(yaw, x, y):
    T = make_transform(rotation_about("z", yaw), [x, y, 0.0])
    move = lambda p: p @ T[:3, :3].T + T[:3, 3]  # noqa: E731
    cloud = box()
    moved = PointCloud(move(cloud.points), viewpoint=move(cloud.viewpoint))
    one = around_hand(view_of(cloud), FROM_ABOVE[None]).astype(float)
    other = around_hand(RangeView(moved, move(CENTER), 0.27), (T @ FROM_ABOVE)[None]).astype(float)
    assert np.mean(np.abs(one - other) > 0.1) < 0.02  # pixels on the outline
    top = np.array([TOP])
    facts = facts_of(FROM_ABOVE[None], CENTER[None], top)
    np.testing.assert_allclose(facts, facts_of((T @ FROM_ABOVE)[None], move(CENTER)[None], top), atol=1e-5)


def test_heights_and_facts():
    T = torch.from_numpy(FROM_ABOVE[None].astype(np.float32))
    grid = heights(T, torch.tensor([TOP]))[0]
    assert grid.shape == CELLS
    # the palm looks down: heights fall along its z by 1 cm a cell, and 10 cm are 1
    np.testing.assert_allclose(np.diff(grid[0, 0, 8:].numpy()), -0.1, atol=1e-4)
    assert grid[0, 0, 0] == 1.0
    middle, up, above = np.split(facts_of(FROM_ABOVE[None], CENTER[None], np.array([TOP]))[0], [3, 6])
    np.testing.assert_allclose(0.1 * middle, [0.03, 0.0, 0.065], atol=1e-6)
    np.testing.assert_allclose(up, [0, 0, -1], atol=1e-6)
    np.testing.assert_allclose(0.1 * above, [HALF[2]], atol=1e-6)


def scene(index: int, width: float, seed: int) -> TriedScene:
    """A box of some width under a hand; held where the fingers' middle is over it."""
    rng = np.random.default_rng(seed)
    cloud = box((width / 2, 0.04, 0.06))
    poses = np.tile(FROM_ABOVE, (24, 1, 1))
    off = rng.uniform(-0.05, 0.05, 24)
    poses[:, 0, 3] += off
    return TriedScene(index, TOP, (cloud, cloud), at_palm(poses), np.zeros(24), np.abs(off) < 0.02)


def test_it_learns_where_the_fingers_must_be_and_goes_on_from_its_checkpoint(tmp_path, monkeypatch):
    from icub_grasp_generators.vgn import classifier_training

    torch.set_num_threads(1)
    monkeypatch.setattr(classifier_training, "BATCH", 32)
    widths = np.linspace(0.04, 0.06, 6)
    scenes = [scene(i, width, i) for i, width in enumerate(widths)] + [scene(9, 0.05, 9)]
    told: list[str] = []

    def stop_after(steps: int):
        def progress(share: float, text: str) -> None:
            told.append(text)
            if f"step {steps}," in text:
                raise KeyboardInterrupt

        return progress

    monkeypatch.setattr(classifier_training, "CHECKPOINT_SECONDS", 0.0)
    with pytest.raises(KeyboardInterrupt):
        fit_classifier(scenes, tmp_path, 0, 3.0, stop_after(3))
    told.clear()
    classifier = fit_classifier(scenes, tmp_path, 0, 3.0, stop_after(10**6))
    first = next(text for text in told if "step" in text)
    assert first.startswith("judge: step 3")  # after the two that were saved
    figures = evaluate_classifier(classifier, scenes)
    assert figures["trials"] == 48
    assert figures["auc"] > 0.9
    assert figures["held_best"] == 1.0
    assert evaluate_classifier(classifier, scenes[:3]) == {"trials": 0.0}
    with pytest.raises(DataError, match="no trials"):
        fit_classifier([scene(9, 0.05, 9)], tmp_path / "none", 0, 1.0, lambda *_: None)
    # scored one by one as in a batch of training
    good, bad = FROM_ABOVE, FROM_ABOVE @ make_transform(np.eye(3), [0.05, 0.0, 0.0])
    high, low = classifier.score(view_of(box()), np.stack([good, bad]), CENTER, TOP)
    assert 0 <= low < high <= 1


def test_weights_with_a_classifier(tmp_path):
    torch.manual_seed(0)
    network, classifier = VgnNetwork(), GraspClassifier()
    save_network(tmp_path / "both.safetensors", network, Meaning(HAND), classifier)
    _, meaning, again = load_network(str(tmp_path / "both.safetensors"))
    assert meaning == Meaning(HAND)
    assert again is not None
    assert not again.training
    for name, value in classifier.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], value)
    save_network(tmp_path / "alone.safetensors", network, Meaning(HAND))
    assert load_network(str(tmp_path / "alone.safetensors"))[2] is None
    classifier.out = torch.nn.Linear(3, 1)
    save_network(tmp_path / "foreign.safetensors", network, Meaning(HAND), classifier)
    with pytest.raises(WeightsError, match="out.weight"):
        load_network(str(tmp_path / "foreign.safetensors"))


def test_poses_are_drawn_where_the_arm_comes_from():
    surface_points = box().points
    T = draw_poses(surface_points, np.random.default_rng(0), 400)
    assert all(is_rigid(pose) for pose in T[:50])
    yaw = np.arctan2(T[:, 1, 0], T[:, 0, 0]) % (2 * np.pi)
    level = np.abs(T[:, 2, 0]) < 1e-9
    assert 0.3 < level.mean() < 0.7
    assert np.all((yaw[level] >= YAW[0]) & (yaw[level] <= YAW[1]))
    assert T[:, 2, 0].min() >= np.sin(DIP[0]) - 1e-9
    down = np.arccos(-T[level][:, 2, 2])
    assert down.max() <= ROLL[1] + 1e-9
    palm = at_palm(T)[:, :3, 3]
    assert np.linalg.norm(palm[:, None] - surface_points[None, ::5], axis=2).min(axis=1).max() < 0.05


def test_fitted_poses_have_the_box_between_the_fingers_and_before_the_palm():
    rng = np.random.default_rng(0)
    poses = np.tile(FROM_ABOVE, (200, 1, 1))
    poses[:, :3, 3] += rng.uniform(-0.02, 0.02, (200, 3))
    moved = fitted(poses, box().points, rng)
    middle = (CENTER - moved[:, :3, 3]) @ FROM_ABOVE[:3, 0]
    assert np.all((middle > 0.015) & (middle < 0.05))
    gap = moved[:, 2, 3] - (CENTER[2] + HALF[2])
    assert np.all((gap > -1e-3) & (gap < 0.011))
    np.testing.assert_array_equal(moved[:, :3, :3], poses[:, :3, :3])
    far = make_transform(FROM_ABOVE[:3, :3], CENTER + 0.5)[None]
    np.testing.assert_array_equal(fitted(far, box().points, rng), far)
    assert gripped_share(moved, box().points).min() > gripped_share(far, box().points)[0] == 0.0


def test_the_same_cloud_is_asked_about_the_same_poses_all_with_something_to_grip():
    cloud = box()
    first, again = (around(cloud.points[::50], cloud) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert len(first) > 100
    assert np.linalg.norm(first[:, :3, :3] @ PALM_POINT + first[:, :3, 3] - CENTER, axis=1).max() < 0.25


@pytest.mark.parametrize("number", range(SHAPES, SHAPES + 24))
def test_random_shapes_are_as_large_and_heavy_as_household_things(number):
    spec, again = random_shape(number), random_shape(number)
    assert [g.size for g in spec.collision] == [g.size for g in again.collision]
    half = np.array(spec.half_extents)
    assert 0.015 <= half[:2].min() <= 0.036  # fits between thumb and fingers one way or the other
    assert 0.025 <= half[2] == spec.rest_height <= 0.135
    reach = np.zeros(3)
    for geom in spec.collision:
        size = np.array(geom.size if geom.shape == "box" else (geom.size[0], geom.size[0], geom.size[1]))
        reach = np.maximum(reach, np.abs(geom.position) + np.abs(quat_wxyz_to_matrix(geom.quat_wxyz) @ size))
    np.testing.assert_allclose(reach, half, atol=1e-9)  # the stated box surrounds it, and no larger one


@pytest.mark.pybullet
def test_trial_objects_are_half_known_half_shapes_and_weigh_by_their_size():
    objects = TrialObjects()
    numbers = objects.draw(np.random.default_rng(0), 5)
    assert sum(number >= SHAPES for number in numbers) == 3
    assert len(set(numbers)) == 5
    for number in numbers:
        spec = objects.get(number)
        assert MASS[0] <= spec.mass <= MASS[1]
        assert spec.mass == objects.get(number).mass
        assert spec.mass <= 900 * 8 * np.prod(spec.half_extents) + MASS[0]
