"""Rendered TARGET-TASKs promise: frames that depend on seed and index only, true masks, a cache that never lies."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icub_core.errors import ConfigError, PluginError
from icub_core.geometry import is_rigid
from icub_core.scene import CameraView, Geom, Material, ObjectSpec, Table
from icub_datasets.rendered import base
from icub_datasets.rendered.hand import WIDEST_GRIP, grips_of, hand_around
from icub_datasets.rendered.handheld import RenderedHandheld, _aim
from icub_datasets.rendered.objects import CLUTTER, HANDHELD, TABLETOP, target_object
from icub_datasets.rendered.store import FrameStore, digest
from icub_datasets.rendered.tabletop import OBJECTS, SEQUENCE_FRAMES, RenderedTabletop, _rectangle, arrange

SMALL = {"width": 96, "height": 72}


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ICUB_CACHE", str(tmp_path / "cache"))


def same(one, other) -> bool:
    (frame, instances), (frame2, instances2) = one, other
    return (
        np.array_equal(frame.rgb, frame2.rgb)
        and np.array_equal(frame.depth, frame2.depth)
        and [i.label for i in instances] == [i.label for i in instances2]
        and all(np.array_equal(i.mask, j.mask) for i, j in zip(instances, instances2, strict=True))
    )


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Both tasks, rendered once for all tests of this file: 13 table-top frames (two rooms), nine held objects."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ICUB_CACHE", str(tmp_path_factory.mktemp("shown")))
        datasets = {
            RenderedTabletop: RenderedTabletop(split="test", frames=13, **SMALL),
            RenderedHandheld: RenderedHandheld(split="test", frames=9, **SMALL),
        }
        for dataset in datasets.values():
            dataset.prepare(lambda share, text: None)
    yield datasets
    for dataset in datasets.values():
        dataset.close()


@pytest.mark.parametrize("cls", [RenderedTabletop, RenderedHandheld])
def test_frames_depend_on_seed_and_index_only(cls, shown):
    first, last = shown[cls], len(shown[cls]) - 1
    second = cls(split="test", frames=len(first), **SMALL)  # its cache is another, and it goes backwards
    assert all(same(second[i], first[i]) for i in (last, 1, 0))
    second.close()
    again = cls(split="test", frames=len(first), **SMALL)  # from disk
    assert all(same(again[i], first[i]) for i in (0, 1, last))
    assert again._simulator is None
    for other in (cls(split="test", frames=len(first), seed=1, **SMALL), cls(split="val", frames=len(first), **SMALL)):
        assert not same(other[0], first[0])
        other.close()


@pytest.mark.parametrize("cls", [RenderedTabletop, RenderedHandheld])
def test_frames_are_annotated_with_what_is_visible(cls, shown):
    dataset, seen = shown[cls], set()
    for frame, instances in dataset:
        assert frame.rgb.shape == (72, 96, 3)
        assert is_rigid(frame.T_world_camera)
        covered = np.zeros((72, 96), int)
        for instance in instances:
            assert instance.label in dataset.classes
            assert instance.mask.sum() >= base.MINIMUM_VISIBLE_SHARE * 96 * 72
            covered += instance.mask
            seen.add(instance.label)
            measured = frame.depth[instance.mask]
            assert (measured > 0.1).all()
            assert (measured < 1.6).all()
        assert covered.max() <= 1  # visible pixels belong to one object
    assert len(seen) >= (6 if cls is RenderedTabletop else 8)
    assert same(dataset[-1], dataset[len(dataset) - 1])


def test_masks_are_where_the_objects_are(shown):
    dataset = shown[RenderedTabletop]  # its last frame was rendered last: the simulator still stands there
    frame, instances = dataset[-1]
    for instance in instances:
        cloud = frame.to_cloud(instance.mask)
        true_pose = dataset._simulator.object_pose(instance.label)
        local = (cloud.points - true_pose[:3, 3]) @ true_pose[:3, :3]
        half = np.array(target_object(instance.label).half_extents)
        assert (np.abs(local) < half + 0.015).mean() > 0.95


def test_damaged_and_missing_files_are_rendered_again(tmp_path, caplog):
    dataset = RenderedTabletop(frames=2, **SMALL)
    before = [dataset[0], dataset[1]]
    files = sorted((tmp_path / "cache").rglob("*.npz"))
    assert len(files) == 2
    files[0].write_bytes(files[0].read_bytes()[:200])
    files[1].unlink()
    assert all(same(dataset[i], before[i]) for i in (0, 1))
    assert "rendering again" in caplog.text
    assert len(list((tmp_path / "cache").rglob("*.npz"))) == 2
    dataset.close()


def test_a_cache_that_cannot_be_written_is_reported_once_and_harmless(tmp_path, caplog, monkeypatch):
    (tmp_path / "occupied").write_text("a file where a folder should be")
    monkeypatch.setenv("ICUB_CACHE", str(tmp_path / "occupied"))
    dataset = RenderedTabletop(frames=2, **SMALL)
    assert [len(dataset[i][1]) > 0 for i in range(2)] == [True] * 2
    assert caplog.text.count("not kept") == 1
    dataset.close()


def test_prepare_renders_what_is_missing_and_can_be_interrupted(tmp_path):
    class Stop(Exception):
        pass

    def interrupt(share, text):
        if share >= 0.5:
            raise Stop

    dataset = RenderedTabletop(frames=4, **SMALL)
    with pytest.raises(Stop):
        dataset.prepare(interrupt)
    assert len(list((tmp_path / "cache").rglob("*.npz"))) == 2
    kept = {f.name: f.stat().st_mtime_ns for f in (tmp_path / "cache").rglob("*.npz")}
    shares = []
    dataset.prepare(lambda share, text: shares.append(share))
    assert shares == [0.25, 0.5, 0.75, 1.0]
    after = {f.name: f.stat().st_mtime_ns for f in (tmp_path / "cache").rglob("*.npz")}
    assert len(after) == 4
    assert kept.items() <= after.items()
    dataset.close()


def test_handheld_objects_come_one_after_another(shown):
    for name, (_, instances) in zip(HANDHELD, shown[RenderedHandheld], strict=True):
        assert {i.label for i in instances} <= {name}


class _SceneRecorder:
    """Stands in for a simulator where only the scene matters."""

    def load(self, robot, scene):
        self.scene = scene

    def reset(self):
        pass

    def set_object_pose(self, name, T_world_object):
        pass


def test_teaching_is_in_one_room_and_testing_in_others():
    def rooms(split):
        dataset, floors = RenderedHandheld(split=split, frames=90), []
        for sequence in range(9):
            recorder = _SceneRecorder()
            dataset._load(recorder, sequence)
            floors.append(recorder.scene.floor.texture.tobytes())
            assert recorder.scene.objects[0].name == HANDHELD[sequence]
        return floors

    train, test = rooms("train"), rooms("test")
    assert len(set(train)) == 1
    assert len(set(test)) == 9
    assert not set(train) & set(test)


def test_a_hand_hides_part_of_what_it_holds(shown):
    dataset = shown[RenderedHandheld]
    simulator, sequence = dataset._simulator, len(HANDHELD) - 1  # the last one is loaded
    view, hidden = CameraView(dataset[-1][0].T_world_camera), []
    for moment in range(0, 32, 4):  # two of each grip
        together = dataset._image(simulator, sequence, moment).segmentation == 0
        for spec in simulator.scene.objects:
            if spec.name.startswith("hand_"):
                simulator.park_object(spec.name)
        alone = simulator.render(view, 96, 72, segmentation=True).segmentation == 0
        assert not (together & ~alone).any()
        hidden.append(1 - together.sum() / alone.sum())
    assert 0.05 < np.mean(hidden) < 0.7


def test_tasks_name_each_object_once_and_never_show_what_stands_behind():
    assert len(TABLETOP) == len(set(TABLETOP)) == 21
    assert len(HANDHELD) == len(set(HANDHELD)) == 9
    assert set(HANDHELD) <= set(TABLETOP)
    assert not set(CLUTTER) & set(TABLETOP)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 400))
def test_objects_are_dealt_evenly_and_never_twice_to_one_table(seed, frames):
    deals = RenderedTabletop(seed=seed, frames=frames)._deals
    assert len(deals) == -(-frames // SEQUENCE_FRAMES)
    count = dict.fromkeys(TABLETOP, 0)
    for deal in deals:
        assert OBJECTS[0] <= len(deal) <= OBJECTS[1]
        assert len(set(deal)) == len(deal)
        for name in deal:
            count[name] += 1
    assert max(count.values()) - min(count.values()) <= 2


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_objects_on_a_table_do_not_enter_one_another(seed):
    rng = np.random.default_rng(seed)
    half = rng.uniform(0.02, 0.12, (8, 3))
    specs = tuple(
        ObjectSpec(f"o{i}", (Geom("box", tuple(h)),), 1.0, tuple(h), h[2]) for i, h in enumerate(half.tolist())
    )
    table = Table()
    poses = arrange(specs, table, rng)
    assert set(poses) == {s.name for s in specs}
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 15), np.linspace(-1, 1, 15)), axis=-1).reshape(-1, 2)
    for i, spec in enumerate(specs):
        T = poses[spec.name]
        assert is_rigid(T)
        assert T[2, 3] == pytest.approx(table.top + half[i, 2])
        points = (grid * half[i, :2]) @ T[:2, :2].T + T[:2, 3]
        for j, other in enumerate(specs):
            if i != j:
                local = (points - poses[other.name][:2, 3]) @ poses[other.name][:2, :2]
                assert not (np.abs(local) < half[j, :2]).all(axis=1).any()


def test_rectangles_have_the_sides_they_were_given():
    corners = _rectangle(1.0, 2.0, 0.3, 0.1, 0.7)
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    np.testing.assert_allclose(sides, [0.6, 0.2, 0.6, 0.2])
    np.testing.assert_allclose(corners.mean(axis=0), [1.0, 2.0])


@given(st.tuples(*[st.floats(0.01, 0.15)] * 3))
@settings(max_examples=40, deadline=None)
def test_hands_close_around_objects_and_leave_on_one_side(half_extents):
    grips = grips_of(half_extents)
    assert grips
    for grip in grips:
        assert grip.closing != grip.arm
        spannable = 2 * half_extents[grip.closing] <= WIDEST_GRIP
        assert spannable or half_extents[grip.closing] == min(half_extents)
        hand = hand_around(half_extents, grip, "hand", (0.8, 0.6, 0.5))
        centers = np.array([g.position for g in hand.collision])
        along = centers @ grip.arm_direction
        assert along.max() > half_extents[grip.arm] + 0.1  # the forearm leaves on the arm's side
        closing = centers[:, grip.closing]
        assert closing.max() > half_extents[grip.closing]  # fingers on one side, thumb on the other
        assert closing.min() < -half_extents[grip.closing]


@settings(deadline=None)
@given(st.integers(0, 5), st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1))
def test_aiming_turns_one_direction_into_another(axis, target):
    direction = np.eye(3)[axis % 3] * (1 if axis < 3 else -1)
    target = np.array(target) / np.linalg.norm(target)
    R = _aim(direction, target)
    np.testing.assert_allclose(R @ direction, target, atol=1e-12)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


@dataclass(frozen=True)
class _Settings:
    a: int = 1
    b: tuple[float, ...] = (1.0, 2.0)


def test_names_of_kept_frames_change_with_everything_they_depend_on(tmp_path):
    file = tmp_path / "mesh.obj"
    file.write_text("v 0 0 0")
    spec = ObjectSpec("o", (Geom("mesh", mesh=file),), 1.0, (0.1, 0.1, 0.1), 0.1)
    texture = np.zeros((4, 4, 3), np.uint8)
    variants = [
        digest(spec, _Settings()),
        digest(spec, _Settings(a=2)),
        digest(spec, _Settings(b=(1.0, 2.5))),
        digest(replace(spec, mass=2.0), _Settings()),
        digest(replace(spec, material=Material(texture=texture)), _Settings()),
        digest(replace(spec, material=Material(texture=texture + 1)), _Settings()),
        digest(spec, (_Settings(),)),
        digest((spec, _Settings())),
    ]
    file.write_text("v 0 0 1")
    variants.append(digest(spec, _Settings()))
    assert len(set(variants)) == len(variants)
    file.write_text("v 0 0 0")
    assert digest(spec, _Settings()) == variants[0]
    with pytest.raises(TypeError):
        digest(object())


def test_kept_frames_hold_no_pickle(tmp_path):
    dataset = RenderedTabletop(frames=1, **SMALL)
    _ = dataset[0]
    dataset.close()
    (file,) = (tmp_path / "cache").rglob("*.npz")
    with np.load(file, allow_pickle=False) as content:
        assert {"rgb", "depth", "segmentation", "labels"} <= set(content.files)
        for name in content.files:
            assert content[name].dtype != object
    file.write_bytes(b"PK\x03\x04 and then nothing")
    assert FrameStore(file.parent.name).get(0) is None


def test_bad_parameters_are_refused_at_once():
    with pytest.raises(ConfigError, match="Did you mean 'test'"):
        RenderedTabletop(split="tests")
    with pytest.raises(ConfigError, match="frames=0"):
        RenderedHandheld(frames=0)
    with pytest.raises(ConfigError, match="16 to 4096 pixels"):
        RenderedTabletop(width=5)
    with pytest.raises(PluginError, match="Did you mean 'mujoco'"):
        RenderedTabletop(engine="mujocco")


@pytest.mark.skipif(importlib.util.find_spec("triton") is None, reason="Triton is not installed")
def test_torch_can_load_its_compiler_after_a_frame_was_rendered():
    # both Mesa and Triton bring an LLVM, and in the wrong order the process dies
    code = (
        "from icub_datasets.rendered.tabletop import RenderedTabletop\n"
        "RenderedTabletop(frames=1, width=32, height=32)[0]\n"
        "import triton\n"
        "print('alive')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "alive", done.stderr[-300:]
