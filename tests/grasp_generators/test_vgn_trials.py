"""Trials in simulation, their files, and a training that goes on where it was."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import torch

from icub_core.data import PointCloud
from icub_core.errors import DataError
from icub_core.geometry import make_transform, rotation_about
from icub_core.scene import Geom, ObjectSpec
from icub_grasp_generators.synthetic_clouds import surface
from icub_grasp_generators.vgn import classifier_training, network_training, training
from icub_grasp_generators.vgn.generation import generate
from icub_grasp_generators.vgn.gripper_trials import TURNS, approaches, middle_of_longest_run
from icub_grasp_generators.vgn.gripper_world import FINGER_DEPTH, MAX_WIDTH, GripperWorld
from icub_grasp_generators.vgn.network import load_network
from icub_grasp_generators.vgn.samples import Draw, draw
from icub_grasp_generators.vgn.trials import TriedScene, is_held_out, read_trials, write_trials

HALF = (0.02, 0.06, 0.05)
BOX = ObjectSpec("box", (Geom("box", HALF),), 0.2, HALF, HALF[2])
EYE = np.array([0.3, 0.1, 0.5])


@pytest.fixture(scope="module")
def world():
    made = GripperWorld(BOX)
    assert made.place(0.0)
    return made


def from_above(yaw: float, depth: float = 0.04) -> np.ndarray:
    """The gripper over the box, its opening along y turned by `yaw`."""
    R = rotation_about("z", yaw) @ rotation_about("x", np.pi)
    return make_transform(R, [0.0, 0.0, 2 * HALF[2] + FINGER_DEPTH - depth])


def test_a_box_is_held_across_its_narrow_side_and_not_across_the_others(world):
    outcome = world.grasp(from_above(np.pi / 2))
    assert outcome.held
    assert outcome.width == pytest.approx(2 * HALF[0], abs=0.01)
    assert not world.grasp(from_above(0.0)).held  # 12 cm: the fingers come down on it
    assert not world.grasp(from_above(np.pi / 2, depth=-0.01)).held  # the fingers end above it
    assert not world.grasp(from_above(np.pi / 2, depth=0.06)).held  # the palm meets it


def test_a_gripper_in_the_table_fails(world):
    sideways = make_transform(rotation_about("z", np.pi / 2) @ rotation_about("x", np.pi / 2), [0.0, 0.1, 0.004])
    assert not world.grasp(sideways).held


def test_the_same_trial_ends_the_same_whatever_came_before(world):
    first = world.grasp(from_above(np.pi / 2 + 0.2))
    world.grasp(from_above(1.0))
    assert world.grasp(from_above(np.pi / 2 + 0.2)) == first


def test_a_view_shows_the_surface_with_its_outward_normals(world):
    cloud, normals = world.view(EYE)
    assert len(cloud) > 500
    np.testing.assert_array_equal(cloud.viewpoint, EYE)
    local = np.abs(cloud.points - world.center) / HALF
    np.testing.assert_allclose(local.max(axis=1), 1.0, atol=1e-3)
    assert np.all(np.sum(normals * (EYE - cloud.points), axis=1) > 0)
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1.0, atol=1e-6)


def test_turns_about_one_approach():
    approach = np.array([0.3, -0.5, -0.8]) / np.linalg.norm([0.3, -0.5, -0.8])
    poses = approaches(np.array([0.1, 0.2, 0.3]), approach)
    for i, T in enumerate(poses):
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        np.testing.assert_allclose(T[:3, 2], approach)
        assert T[:3, 0] @ poses[0][:3, 0] == pytest.approx(np.cos(np.pi * i / TURNS))


@pytest.mark.parametrize(
    ("success", "middle"), [("001000", 2), ("011100", 2), ("100011", 5), ("110001", 0), ("111111", 0), ("101110", 3)]
)
def test_middle_of_the_longest_run_round_the_circle(success, middle):
    assert middle_of_longest_run(np.array([c == "1" for c in success])) == middle


def scene(index: int, seed: int = 0, trials: int = 12) -> TriedScene:
    """A box seen once, held wherever the palm is above it: made up, but something to learn."""
    rng = np.random.default_rng(seed)
    points, normals = surface("box", np.array(HALF), rng, 4000)
    points = points + [0.0, 0.0, HALF[2]]
    seen = np.sum(normals * (EYE - points), axis=1) > 0
    poses = np.tile(make_transform(rotation_about("z", np.pi) @ np.diag([1.0, -1.0, -1.0])), (trials, 1, 1))
    high = np.arange(trials) % 2 == 0
    poses[:, :3, 3] = np.stack([*rng.uniform(-0.008, 0.008, (2, trials)), np.where(high, 0.11, 0.03)], axis=1)
    view = PointCloud(points[seen], viewpoint=EYE)
    return TriedScene(index, 0.0, (view, view), poses, np.full(trials, 0.04), high)


def test_files_give_back_what_was_written(tmp_path):
    scenes = [scene(3), scene(9, 1, 5), TriedScene(4, 0.1, scene(0).views[:1], *_none())]
    write_trials(tmp_path / "a.npz", scenes)
    again = list(read_trials(tmp_path / "a.npz"))
    assert [s.object_index for s in again] == [3, 9, 4]
    assert [s.held_out for s in again] == [False, True, False]
    for one, other in zip(scenes, again, strict=True):
        assert one.table_top == other.table_top
        np.testing.assert_array_equal(one.success, other.success)
        np.testing.assert_array_equal(one.poses, other.poses)
        np.testing.assert_array_equal(one.widths, other.widths)
        assert len(one.views) == len(other.views)
        for a, b in zip(one.views, other.views, strict=True):
            np.testing.assert_allclose(a.points, b.points, atol=1e-6)
            np.testing.assert_array_equal(a.viewpoint, b.viewpoint)


def _none():
    return np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, dtype=bool)


def test_no_file_of_trials(tmp_path):
    (tmp_path / "noise.npz").write_bytes(b"noise")
    np.savez(tmp_path / "foreign.npz", x=np.zeros(2))
    for name in ("noise.npz", "foreign.npz", "absent.npz"):
        with pytest.raises(DataError, match=name):
            list(read_trials(tmp_path / name))
    with pytest.raises(DataError, match="viewpoint"):
        write_trials(tmp_path / "b.npz", [TriedScene(0, 0.0, (PointCloud(np.zeros((5, 3))),), *_none())])


def test_a_tenth_of_the_objects_is_held_out():
    assert sum(is_held_out(i) for i in range(1000)) == 100


@pytest.mark.parametrize("pose", ["gripper", "hand"])
def test_a_draw_moves_poses_and_field_together(pose):
    """Whatever turn and shift were drawn, trials held above the box lie outside of its surface, the others not."""
    seen = 0
    for seed in range(12):
        drawn = draw(scene(0), pose, np.random.default_rng(seed))
        if drawn is None:
            continue
        seen += 1
        field = drawn.tsdf.astype(np.float32)
        assert field.shape == (40, 40, 40)
        values = field[tuple(drawn.index.T)]
        assert np.all(values[drawn.label] > 0.5)
        assert np.all(values[~drawn.label] < 0.5)
        np.testing.assert_allclose(np.linalg.norm(drawn.quaternion, axis=1), 1.0)
    assert seen >= 6


def test_a_step_takes_as_many_held_as_not():
    label = np.arange(20) < 6
    many = Draw(np.zeros((40, 40, 40), np.float16), np.zeros((30, 3), int), label, np.zeros((30, 4)), np.zeros(30))
    part = many.balanced(np.random.default_rng(0))
    assert part.label.sum() == 6
    assert len(part.label) == 12


class MadeUp:
    """Two scenes a batch; counts the batches."""

    made = 0

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def batch(self, number: int) -> list[TriedScene]:
        type(self).made += 1
        return [scene(2 * number + 8, 2 * number), scene(2 * number + 9, 2 * number + 1)]


def test_generating_goes_on_after_the_last_file(tmp_path):
    MadeUp.made, told = 0, []
    assert len(generate(MadeUp(0), tmp_path, 3, np.inf, lambda f, t: told.append((f, t)))) == 3
    (tmp_path / "batch_00001.npz").unlink()
    assert len(generate(MadeUp(0), tmp_path, 4, np.inf, lambda *_: None)) == 4
    assert MadeUp.made == 5
    assert told[0] == (0.0, "batch 0: 12 of 24 grasps held")
    assert len(generate(MadeUp(0), tmp_path / "late", 4, -np.inf, lambda *_: None)) == 1


@pytest.fixture
def quick(monkeypatch):
    torch.set_num_threads(1)
    parts = tuple(training.Part(p.name, p.pose, MadeUp, p.data, 0.05, 0.4) for p in training.PARTS)
    monkeypatch.setattr(training, "PARTS", parts)
    monkeypatch.setattr(training, "CLASSIFIER_SHARE", 0.1)
    monkeypatch.setattr(training, "MAX_BATCHES", 2)
    monkeypatch.setattr(network_training, "SCENES_PER_STEP", 2)
    monkeypatch.setattr(network_training, "VARIANTS", 2)
    monkeypatch.setattr(classifier_training, "BATCH", 8)


def test_training_writes_weights_and_cards_and_goes_on(quick, tmp_path):
    shares = []
    training.train(tmp_path, 0, 0.03, lambda share, text: shares.append((share, text)))
    assert all(0.0 <= share <= 1.0 for share, _ in shares)
    for name, pose in (("parallel_jaw", "gripper"), ("icub_hand", "hand")):
        _, meaning, classifier = load_network(str(tmp_path / f"{name}.safetensors"))
        assert meaning.pose == pose
        assert (classifier is not None) == (pose == "hand")
        card = json.loads((tmp_path / f"{name}.json").read_text())
        assert card["command"] == "icub train grasp_generator=vgn --seed 0 --minutes 0.03"
        assert card["figures"]["trials"] > 0
        assert ("judge_trials" in card["figures"]) == ("judge" in card["steps"]) == (pose == "hand")
    steps = card["steps"]
    before = (tmp_path / "icub_hand.safetensors").read_bytes()
    training.train(tmp_path, 0, 0.03, lambda *_: None)  # nothing is left to do
    assert (tmp_path / "icub_hand.safetensors").read_bytes() == before
    training.train(tmp_path, 0, 0.06, lambda *_: None)
    assert json.loads((tmp_path / "icub_hand.json").read_text())["steps"]["network"] > steps["network"]


def test_a_training_that_was_interrupted_has_its_checkpoint(quick, tmp_path, monkeypatch):
    monkeypatch.setattr(network_training, "CHECKPOINT_SECONDS", 0.0)

    def stop(share: float, text: str) -> None:
        if "icub_hand: step 2" in text:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        training.train(tmp_path, 0, 0.1, stop)
    kept = tmp_path / "kept"
    shutil.copytree(tmp_path, kept)
    told = []
    training.train(kept, 0, 0.1, lambda share, text: told.append(text))
    first = next(text for text in told if text.startswith("icub_hand: step"))
    assert first.startswith("icub_hand: step 2")  # after the one that was saved


def test_learning_tells_held_from_missed():
    """The made-up rule (above the box: held) is learned in a few dozen steps and holds on another box."""
    torch.manual_seed(0)
    network = network_training.VgnNetwork()
    fields = network_training.Fields([scene(0, 0), scene(1, 1)], "hand", 0)
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    network_training.SCENES_PER_STEP, before = 4, network_training.SCENES_PER_STEP
    try:
        for step in range(20):
            batch = fields.batch(step)
            loss = network_training.loss_of(network.at_voxels(batch.tsdf, batch.scene, batch.index), batch, "hand")
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    finally:
        network_training.SCENES_PER_STEP = before
    figures = network_training.evaluate(network, [scene(9, 5)], "hand")
    assert figures["auc"] > 0.95


def test_the_largest_opening_is_recorded_for_what_failed(world):
    assert world.grasp(from_above(0.0)).width == MAX_WIDTH


@pytest.mark.pybullet
@pytest.mark.slow
def test_trials_with_the_robot_s_hand(monkeypatch):
    """Poses are tried with the task's own script; some hold, some do not, and all start around the object."""
    from icub_grasp_generators.vgn import hand_trials

    monkeypatch.setattr(hand_trials, "WORLDS", 2)
    monkeypatch.setattr(hand_trials, "PLACEMENTS", 1)
    scenes = hand_trials.HandTrials(0).batch(0)
    again = hand_trials.HandTrials(0).batch(0)
    assert scenes
    for one, other in zip(scenes, again, strict=True):
        np.testing.assert_array_equal(one.success, other.success)
        np.testing.assert_array_equal(one.poses, other.poses)
    for tried in scenes:
        assert len(tried.views) == 1 + hand_trials.FURTHER_VIEWS
        cloud = np.concatenate([view.points for view in tried.views])
        gap = np.linalg.norm(tried.poses[:, None, :3, 3] - cloud[None, ::10], axis=2).min(axis=1)
        assert np.median(gap) < 0.04
    held = np.concatenate([s.success for s in scenes])
    assert 0 < held.sum() < len(held)


@pytest.mark.pybullet
def test_a_batch_of_gripper_trials_is_decided_by_its_number(monkeypatch):
    from icub_grasp_generators.vgn import gripper_trials

    monkeypatch.setattr(gripper_trials, "OBJECTS", 1)
    monkeypatch.setattr(gripper_trials, "POINTS", 12)
    first, again = (gripper_trials.GripperTrials(3).batch(7) for _ in range(2))
    other = gripper_trials.GripperTrials(3).batch(8)
    assert len(first) == len(again) == gripper_trials.PLACEMENTS
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.poses, two.poses)
        np.testing.assert_array_equal(one.success, two.success)
        assert one.object_index == two.object_index
        assert len(one.views) == gripper_trials.VIEWS
    assert other[0].object_index != first[0].object_index or not np.array_equal(other[0].poses, first[0].poses)
