"""Contract of segmenters."""

from __future__ import annotations

import tempfile
from pathlib import Path

from icub_core.data import Instance, RgbdFrame, tight_boxes
from icub_core.errors import CheckpointError, NotFittedError
from icub_core.interfaces.abilities import AddsClasses
from icub_core.interfaces.segmenter import Segmenter
from icub_support.overlap import mask_iou
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_raises, expect_same
from icub_testing.tiny.things import draw_frame

PICKLE_BEGINNINGS = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05", b"PK\x03\x04")
"""First bytes of pickles and of the archives in which torch hides them."""

Sample = tuple[RgbdFrame, tuple[Instance, ...]]


def _shown(color: str, frames: int = 4) -> list[Sample]:
    """Show one disc at several places and sizes."""
    places = [(45 + 18 * i, 45 + 9 * i, 16 + i % 3) for i in range(frames)]
    return [draw_frame({color: place}, seed=i) for i, place in enumerate(places)]


def _test_frame() -> RgbdFrame:
    return draw_frame({"red": (45, 50, 17), "blue": (115, 70, 17)}, seed=99)[0]


def _taught(make: Make, *colors: str) -> Segmenter:
    segmenter: Segmenter = make()
    for color in colors:
        for frame, instances in _shown(color):
            segmenter.observe(frame, instances)
    segmenter.update()
    return segmenter


def _same(first: tuple[Instance, ...], second: tuple[Instance, ...], what: str) -> None:
    expect([i.label for i in first] == [i.label for i in second], f"{what} with the same labels", "others")
    for one, other in zip(first, second, strict=True):
        expect_same(one.mask, other.mask, f"{what}: masks")
        expect_same(one.score, other.score, f"{what}: scores")


def check_untaught(make: Make) -> None:
    """Segmenting before any update raises NotFittedError."""
    expect_raises(NotFittedError, lambda: make().segment(_test_frame()), "before update")
    segmenter = make()
    segmenter.observe(*_shown("red")[0])
    expect_raises(NotFittedError, lambda: segmenter.segment(_test_frame()), "after observe but before update")


def check_classes(make: Make) -> None:
    """The classes are those that were taught, known from the update on."""
    segmenter = make()
    for color in ("red", "blue"):
        for sample in _shown(color):
            segmenter.observe(*sample)
    expect(tuple(segmenter.classes) == (), "no classes before the first update", segmenter.classes)
    report = segmenter.update()
    expect(sorted(segmenter.classes) == ["blue", "red"], "the classes blue and red", segmenter.classes)
    expect(sorted(report.classes) == ["blue", "red"], "the update's report to name blue and red", report.classes)
    expect(report.seconds >= 0, "seconds of the update", report.seconds)


def check_finds(make: Make) -> None:
    """What was taught is found again: a mask that overlaps the object's by half, under its own label."""
    frame, truth = draw_frame({"red": (50, 52, 17), "blue": (105, 80, 17)}, seed=7)
    found = _taught(make, "red", "blue").segment(frame)
    for instance in truth:
        same = [f.mask for f in found if f.label == instance.label]
        best = float(mask_iou([instance.mask], same).max(initial=0.0))
        expect(best >= 0.5, f"a mask of '{instance.label}' with an overlap of 0.5 at least", f"{best:.2f}")


def check_labels(make: Make) -> None:
    """Only taught labels are reported."""
    labels = {i.label for i in _taught(make, "red").segment(_test_frame())}
    expect(labels <= {"red"}, "no label but red", labels)


def check_masks(make: Make) -> None:
    """Masks have the image's size, are not empty and lie in their boxes."""
    frame, _ = draw_frame({"red": (60, 60, 20)}, seed=3, size=(130, 170))
    for instance in _taught(make, "red").segment(frame):
        expect(instance.mask.shape == (130, 170), "a mask of (130, 170)", instance.mask.shape)
        expect(instance.mask.any(), "a mask with pixels", "an empty one")
        beyond = (tight_boxes(instance.mask[None])[0] - instance.box) * [-1, -1, 1, 1]
        expect(bool((beyond <= 1).all()), "the mask within its box, give or take a pixel", instance.box.tolist())


def check_order(make: Make) -> None:
    """Finds come best score first."""
    scores = [i.score for i in _taught(make, "red", "blue").segment(_test_frame())]
    expect(scores == sorted(scores, reverse=True), "falling scores", scores)


def check_keeps_old_classes(make: Make) -> None:
    """What is taught later is added: old classes stay known and are still found."""
    segmenter = _taught(make, "red")
    for sample in _shown("blue"):
        segmenter.observe(*sample)
    segmenter.update()
    expect(sorted(segmenter.classes) == ["blue", "red"], "the classes blue and red", segmenter.classes)
    labels = {i.label for i in segmenter.segment(_shown("red")[0][0])}
    expect("red" in labels, "red to be found after blue was taught", labels or "nothing")


def check_adds_classes(make: Make) -> None:
    """A segmenter that adds classes knows and finds the old and the new ones."""
    segmenter = _taught(make, "red")
    if not isinstance(segmenter, AddsClasses):
        return
    for sample in _shown("blue"):
        segmenter.observe(*sample)
    report = segmenter.add_classes()
    expect(sorted(report.classes) == ["blue", "red"], "the report to name blue and red", report.classes)
    expect(sorted(segmenter.classes) == ["blue", "red"], "the classes blue and red", segmenter.classes)
    for color in ("red", "blue"):
        labels = {i.label for i in segmenter.segment(_shown(color)[0][0])}
        expect(color in labels, f"{color} to be found after blue was added", labels or "nothing")


def check_negative_frames(make: Make) -> None:
    """A frame without instances is taken as a negative example."""
    segmenter = make()
    for sample in _shown("red"):
        segmenter.observe(*sample)
    segmenter.observe(draw_frame({}, seed=50)[0], ())
    segmenter.update()
    expect(tuple(segmenter.classes) == ("red",), "the class red alone", segmenter.classes)


def check_repeatable(make: Make) -> None:
    """The same frames and seed give the same result."""
    first, second = (_taught(make, "red", "blue").segment(_test_frame()) for _ in range(2))
    _same(first, second, "results of two segmenters taught alike")


def check_segment_changes_nothing(make: Make) -> None:
    """Segmenting does not teach: the same frame gives the same result later."""
    segmenter = _taught(make, "red", "blue")
    first = segmenter.segment(_test_frame())
    segmenter.segment(_shown("blue")[2][0])
    _same(first, segmenter.segment(_test_frame()), "results of one frame")


def check_inputs_unchanged(make: Make) -> None:
    """Frames and masks that are passed in are not changed."""
    frame, instances = _shown("red")[0]
    segmenter = make()
    segmenter.observe(frame, instances)
    segmenter.update()
    segmenter.segment(frame)
    fresh_frame, fresh_instances = _shown("red")[0]
    expect_same(frame.rgb, fresh_frame.rgb, "the image before and after")
    expect_same(frame.depth, fresh_frame.depth, "the depth before and after")
    expect_same(instances[0].mask, fresh_instances[0].mask, "the mask before and after")


def check_save_and_load(make: Make) -> None:
    """A fresh segmenter that loads what another one saved gives the same result."""
    segmenter, other = _taught(make, "red", "blue"), make()
    with tempfile.TemporaryDirectory() as folder:
        segmenter.save(Path(folder, "heads"))
        other.load(Path(folder, "heads"))
    expect(sorted(other.classes) == sorted(segmenter.classes), f"the classes {segmenter.classes}", other.classes)
    _same(segmenter.segment(_test_frame()), other.segment(_test_frame()), "results after loading")


def check_no_pickle(make: Make) -> None:
    """What is saved holds no pickle."""
    with tempfile.TemporaryDirectory() as folder:
        _taught(make, "red").save(Path(folder, "heads"))
        files = [file for file in Path(folder).rglob("*") if file.is_file()]
        expect(files, "files in the folder", "none")
        for file in files:
            with file.open("rb") as stream:
                beginning = stream.read(4)
            expect(not beginning.startswith(PICKLE_BEGINNINGS), f"{file.name} without pickle", beginning)


def check_bad_file(make: Make) -> None:
    """Loading anything else raises CheckpointError, and the segmenter stays as it was."""
    segmenter = _taught(make, "red")
    before = segmenter.segment(_test_frame())
    with tempfile.TemporaryDirectory() as folder:
        expect_raises(
            CheckpointError, lambda: segmenter.load(Path(folder, "nowhere")), "for a folder that does not exist"
        )
        other = Path(folder, "broken")
        make_broken = _taught(make, "blue")
        make_broken.save(other)
        for file in [f for f in other.rglob("*") if f.is_file()]:
            file.write_bytes(b"not what was written")
        expect_raises(CheckpointError, lambda: segmenter.load(other), "for overwritten files")
    expect(tuple(segmenter.classes) == ("red",), "the class red after refused loads", segmenter.classes)
    _same(before, segmenter.segment(_test_frame()), "results before and after refused loads")
