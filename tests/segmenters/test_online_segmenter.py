"""The segmenter as its user sees it: taught by frames, asked for instances, saved and loaded."""

import json

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from icub_core.data import Instance
from icub_core.errors import CheckpointError, ConfigError, DataError, NotFittedError
from icub_segmenters.heads.linear import Linear
from icub_segmenters.online_segmenter import OnlineSegmenter
from icub_segmenters.procedure import Procedure
from icub_support.detection import evaluate_instances

COLORS = ["red", "green", "blue"]


@pytest.fixture
def make(windows, falkon):
    def build(head=falkon, **options):
        return OnlineSegmenter(windows, head, **{"composites": 0, **options})

    return build


def teach(segmenter, frames):
    for frame, instances in frames:
        segmenter.observe(frame, instances)
    return segmenter.update()


def scenes(painter):
    return [
        painter([("red", 30, 30, 15), ("blue", 90, 60, 18), ("yellow", 90, 22, 14)], seed=100),
        painter([("green", 40, 60, 16), ("yellow", 20, 20, 13)], seed=101),
        painter([("blue", 35, 50, 14), ("green", 100, 30, 17)], seed=102),
    ]


@pytest.mark.parametrize("mode", ["shared", "faithful"])
def test_taught_colors_are_found_and_the_untaught_is_not(make, painter, teacher, mode):
    segmenter = make(mode=mode)
    # the yellow distractor is shown once without a label, as clutter
    report = teach(segmenter, [*teacher(COLORS), (painter([("yellow", 60, 40, 16)])[0], ())])
    assert report.classes == segmenter.classes == tuple(COLORS)
    assert set(report.parts) == {"detection", "masks"}
    assert all(report.samples[c] >= 6 for c in COLORS)
    truth = [[i for i in instances if i.label != "yellow"] for _, instances in scenes(painter)]
    found = [segmenter.segment(frame) for frame, _ in scenes(painter)]
    metrics = evaluate_instances(truth, found, COLORS)
    assert metrics.map50_segm > 0.95
    assert metrics.map70_segm > 0.95
    for image in found:
        assert [i.score for i in image] == sorted((i.score for i in image), reverse=True)
        assert all(i.mask.shape == (96, 128) and i.label in COLORS for i in image)


def test_a_linear_head_serves_as_well(make, painter, teacher):
    procedure = Procedure(min_score=-5.0)  # log odds have a scale of their own
    segmenter = make(head=lambda: Linear(epochs=30, learning_rate=0.01), procedure=procedure)
    teach(segmenter, teacher(COLORS))
    truth = [[i for i in instances if i.label != "yellow"] for _, instances in scenes(painter)]
    assert evaluate_instances(truth, [segmenter.segment(f) for f, _ in scenes(painter)], COLORS).map50_segm > 0.9


def test_features_are_extracted_when_observed_and_never_by_update(make, windows, teacher):
    segmenter = make(composites=2)
    for frame, instances in teacher(["red"], count=2):
        segmenter.observe(frame, instances)
    assert windows.extracted == 2 * (1 + 2)
    segmenter.update()
    assert windows.extracted == 6


def test_old_classes_are_kept_when_new_ones_come(make, painter, teacher):
    segmenter = make()
    teach(segmenter, teacher(["red", "green"]))
    masks_of_red = segmenter.masks.heads[0].state_dict()["alpha"].clone()
    report = teach(segmenter, teacher(["blue"], seed=1))
    assert report.classes == ("red", "green", "blue")
    assert torch.equal(segmenter.masks.heads[0].state_dict()["alpha"], masks_of_red)  # thesis 11.8.1
    found = segmenter.segment(painter([("red", 30, 30, 15), ("blue", 90, 60, 18)], seed=7)[0])
    assert {i.label for i in found if i.score > 0} == {"red", "blue"}


def test_updates_in_between_change_nothing(make, painter, teacher):
    often, once = make(composites=1), make(composites=1)
    for frame, instances in teacher(COLORS, count=3):
        often.observe(frame, instances)
        often.update()
        once.observe(frame, instances)
    once.update()
    frame = scenes(painter)[0][0]
    for a, b in zip(often.segment(frame), once.segment(frame), strict=True):
        assert (a.label, a.score) == (b.label, b.score)
        assert np.array_equal(a.mask, b.mask)


def test_same_frames_and_seed_give_the_same_result(make, painter, teacher):
    results = []
    for _ in range(2):
        segmenter = make(composites=2, seed=3)
        teach(segmenter, teacher(["red", "blue"], count=3))
        results.append(segmenter.segment(scenes(painter)[0][0]))
    for a, b in zip(*results, strict=True):
        assert a.score == b.score
        assert np.array_equal(a.mask, b.mask)


def test_one_instance_is_enough_to_be_found_again(make, painter, teacher):
    segmenter = make()
    teach(segmenter, [*teacher(["red"]), painter([("blue", 60, 50, 16)])])
    best = max(segmenter.segment(painter([("blue", 80, 40, 17)], seed=5)[0]), key=lambda i: i.score)
    assert best.label == "blue"


def test_a_class_whose_mask_fills_its_box_gets_its_box_as_mask(make, painter):
    segmenter = make()
    frame, _ = painter([])
    mask = np.zeros((96, 128), dtype=bool)
    mask[20:60, 30:70] = True
    frame.rgb[mask] = (220, 30, 30)
    teach(segmenter, [(frame, (Instance.from_mask("square", mask),))])
    best = segmenter.segment(frame)[0]
    assert best.label == "square"
    assert (best.mask & mask).sum() / (best.mask | mask).sum() > 0.6


def test_nothing_can_be_asked_before_something_was_taught(make, painter, tmp_path):
    segmenter = make()
    frame, _ = painter([])
    with pytest.raises(NotFittedError, match="observe"):
        segmenter.update()
    segmenter.observe(frame, ())
    with pytest.raises(NotFittedError, match="at least one frame with an instance"):
        segmenter.update()
    with pytest.raises(NotFittedError):
        segmenter.segment(frame)
    with pytest.raises(NotFittedError):
        segmenter.save(tmp_path)
    assert segmenter.classes == ()


def test_bad_masks_are_refused_and_leave_the_learner_usable(make, painter, teacher):
    segmenter = make()
    frame, (instance,) = painter([("red", 60, 40, 15)])
    empty = Instance("red", 1.0, instance.box, np.zeros((96, 128), dtype=bool))
    with pytest.raises(DataError, match="'red' is empty"):
        segmenter.observe(frame, (instance, empty))
    foreign = Instance("red", 1.0, instance.box, np.ones((10, 10), dtype=bool))
    with pytest.raises(DataError, match=r"\(10, 10\); expected the image's \(96, 128\)"):
        segmenter.observe(frame, (foreign,))
    assert len(segmenter.store) == 0
    assert teach(segmenter, teacher(["red"])).classes == ("red",)


def test_frames_of_other_sizes_are_segmented_at_their_own_size(make, painter, teacher):
    segmenter = make()
    teach(segmenter, teacher(COLORS))
    found = segmenter.segment(painter([("red", 100, 100, 16)], size=(150, 210))[0])
    assert found[0].label == "red"
    assert found[0].mask.shape == (150, 210)


def test_saved_and_loaded_it_sees_the_same_and_learns_on_as_if_never_stopped(make, painter, teacher, tmp_path):
    first, second = make(composites=1), make(composites=1)
    teach(first, teacher(["red", "green"]))
    first.save(tmp_path / "taught")
    second.load(tmp_path / "taught")
    frame = scenes(painter)[0][0]
    assert [i.score for i in second.segment(frame)] == [i.score for i in first.segment(frame)]
    for segmenter in (first, second):
        # composites beside remembered objects are not part of what is saved
        segmenter.composites = 0
        teach(segmenter, teacher(["blue"], seed=1))
    assert second.classes == ("red", "green", "blue")
    for a, b in zip(second.segment(frame), first.segment(frame), strict=True):
        assert a.score == b.score
        assert np.array_equal(a.mask, b.mask)


def test_foreign_and_broken_files_are_refused_and_change_nothing(make, painter, teacher, tmp_path):
    segmenter = make()
    teach(segmenter, teacher(["red", "green"], count=3))
    frame = scenes(painter)[0][0]
    before = [i.score for i in segmenter.segment(frame)]
    segmenter.save(tmp_path / "good")
    file = tmp_path / "good" / "segmenter.safetensors"
    for name, content in (("empty", b""), ("truncated", file.read_bytes()[:5000]), ("text", b"hello, no tensors here")):
        (tmp_path / name).mkdir()
        (tmp_path / name / file.name).write_bytes(content)
    (tmp_path / "foreign").mkdir()
    save_file({"weight": torch.ones(3)}, tmp_path / "foreign" / file.name)
    (tmp_path / "missing").mkdir()
    about = {"format": 1, "labels": ["a"], "trained": 1, "observed": 1, "region_dim": 75, "mask_dim": 6}
    for name, change in (("other_network", {"region_dim": 99}), ("no_tensors", {})):
        (tmp_path / name).mkdir()
        save_file({"x": torch.ones(1)}, tmp_path / name / file.name, {"about": json.dumps({**about, **change})})
    (tmp_path / "lost_tensor").mkdir()
    tensors = load_file(file)
    tensors.pop("detector.head.0.alpha")
    save_file(tensors, tmp_path / "lost_tensor" / file.name, {"about": json.dumps(about)})
    for name in ("empty", "truncated", "text", "foreign", "missing", "other_network", "no_tensors", "lost_tensor"):
        with pytest.raises(CheckpointError):
            segmenter.load(tmp_path / name)
    assert [i.score for i in segmenter.segment(frame)] == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mode": "sharred"}, "Did you mean 'shared'"),
        ({"masks": "on-line"}, "Did you mean 'online'"),
        ({"masks": "pretrained"}, "mask branch"),
        ({"proposals": "online"}, "region proposal network"),
        ({"composites": -1}, "composites is -1"),
        ({"batches": 0}, "Minibootstrap of 0 batches"),
    ],
)
def test_impossible_options_are_refused(make, options, message):
    with pytest.raises(ConfigError, match=message):
        make(**options)


def test_memory_stays_bounded_however_long_the_showing(make, teacher):
    segmenter = make(batches=1, batch_size=100)
    for frame, instances in teacher(["red"], count=25):
        segmenter.observe(frame, instances)
    assert int((segmenter.store.near < 0).sum()) <= 1.5 * 100
    assert segmenter.update().samples["red"] >= 25
