"""One more class taught after 21 others: how long its training takes, and what the others lose.

    icub benchmark incremental
    icub benchmark incremental --runs 3
    icub benchmark incremental --train-frames 48 --test-frames 24 --new-frames 12

21 objects of the rendered table-top task are taught and learned; then another object is shown alone. It is learned by
`OnlineSegmenter.add_classes`, which leaves the others as they are, and, from the same frames, by `update`, which trains
all classes anew as thesis 11.8.1 does. Old classes are examined before and after on test frames on which the new object
does not occur; the new one on frames where it stands among old ones, and so is how often it is taken for one of them.

Runs are kept one by one in the work folder: the same line resumes an interrupted benchmark. They are known by seed,
numbers of frames and overrides, not by the code: measure again with --fresh after changing it.
Rendered frames are kept in the user's cache folder and made when they are missing.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import statistics
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from icub_benchmarks.figures import Figure
from icub_benchmarks.results import command_line, make_parser, work_folder, write_figures
from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_core.data import Instance, RgbdFrame
from icub_core.files import write_text_atomically
from icub_core.interfaces.segmenter import Segmenter
from icub_core.scene import ObjectSpec
from icub_datasets.rendered.objects import CLUTTER, TABLETOP, target_object
from icub_datasets.rendered.tabletop import RenderedTabletop
from icub_support.detection import DetectionMetrics, evaluate_instances

NEW = CLUTTER[0]
COMPANIONS = 4
Examples = Iterable[tuple[RgbdFrame, Sequence[Instance]]]


class NewObject(RenderedTabletop):
    """The object that comes later, alone on tables, or among old ones in the test split; only it is annotated."""

    def __init__(self, split: str, frames: int, seed: int) -> None:
        super().__init__(split, frames, seed)
        self._classes = (NEW,)

    def _objects(self) -> tuple[ObjectSpec, ...]:
        return (target_object(NEW), *super()._objects())

    def _deal(self) -> list[list[str]]:
        if self._split == "train":
            return [[NEW]] * len(super()._deal())
        return [[NEW, *deal[:COMPANIONS]] for deal in super()._deal()]


def kept_or_run(options: argparse.Namespace, seed: int, progress: Progress) -> dict[str, float]:
    """Return the figures of one run, read back if it was finished before."""
    chosen = [seed, options.train_frames, options.new_frames, options.test_frames, sorted(options.overrides)]
    key = hashlib.sha256(repr(chosen).encode()).hexdigest()[:12]
    file = options.work / f"{seed}-{key}.json"
    if file.exists() and not options.fresh:
        kept: dict[str, float] = json.loads(file.read_text())
        return kept
    figures = run(options, seed, progress)
    write_text_atomically(file, json.dumps(figures, indent=1))
    return figures


def run(options: argparse.Namespace, seed: int, progress: Progress) -> dict[str, float]:
    """Teach, add, examine; return the figures of one run by the last part of their keys."""
    segmenter = Assembly(compose(["segmenter=falkon", f"seed={seed}", *options.overrides])).get("segmenter")
    train = RenderedTabletop("train", options.train_frames, seed)
    test = RenderedTabletop("test", options.test_frames, seed)
    training_images, among = (
        NewObject(split, n, seed) for split, n in (("train", options.new_frames), ("test", options.test_frames // 2))
    )
    show(segmenter, train, len(train), "teaching 21 objects", progress)
    segmenter.update()
    old = list(segmenter.classes)
    before = examine(segmenter, test, old, "examining", progress)
    mistaken_before = mistaken(segmenter, among, "mistaken for old ones", progress)
    show(segmenter, training_images, len(training_images), "showing one more", progress)
    added = segmenter.add_classes()
    after = examine(segmenter, test, old, "examining after the addition", progress)
    new = examine(segmenter, among, [NEW], "examining the new object", progress)
    mistaken_after = mistaken(segmenter, among, "mistaken for old ones", progress)
    whole = segmenter.update()
    retrained = examine(segmenter, test, old, "examining after training anew", progress)
    new_retrained = examine(segmenter, among, [NEW], "examining the new object", progress)
    mistaken_retrained = mistaken(segmenter, among, "mistaken for old ones", progress)
    for data in (train, test, training_images, among):
        data.close()
    return {
        "old_classes": float(len(old)),
        "add_class_s": added.seconds,
        "retrain_s": whole.seconds,
        "old_class_change": largest_change(before, after),
        "old_class_change_retrained": largest_change(before, retrained),
        "old_map50_change": 100 * (after.map50_segm - before.map50_segm),
        "old_map50_change_retrained": 100 * (retrained.map50_segm - before.map50_segm),
        "new_ap50": 100 * new.map50_segm,
        "new_ap50_retrained": 100 * new_retrained.map50_segm,
        "mistaken_before": 100 * mistaken_before,
        "mistaken_after": 100 * mistaken_after,
        "mistaken_retrained": 100 * mistaken_retrained,
    }


def show(segmenter: Segmenter, frames: Examples, count: int, title: str, progress: Progress) -> None:
    """Observe every frame."""
    for frame, instances in progress.track(frames, total=count, description=title):
        segmenter.observe(frame, instances)


def examine(
    segmenter: Segmenter, frames: RenderedTabletop, classes: list[str], title: str, progress: Progress
) -> DetectionMetrics:
    """Segment every frame and compare with what is there."""
    truth, found = [], []
    for frame, instances in progress.track(frames, total=len(frames), description=title):
        truth.append(instances)
        found.append([i for i in segmenter.segment(frame) if i.label in classes])
    return evaluate_instances(truth, found, classes)


def mistaken(segmenter: Segmenter, frames: RenderedTabletop, title: str, progress: Progress) -> float:
    """Return the share of new objects on which an old class is reported with a score above 0, overlap 0.5 or more."""
    count = wrong = 0
    for frame, instances in progress.track(frames, total=len(frames), description=title):
        found = [i for i in segmenter.segment(frame) if i.label != NEW and i.score > 0]
        for new in instances:
            count += 1
            overlaps = ((i.mask & new.mask).sum() / (i.mask | new.mask).sum() for i in found)
            wrong += any(overlap >= 0.5 for overlap in overlaps)
    return wrong / max(count, 1)


def largest_change(before: DetectionMetrics, after: DetectionMetrics) -> float:
    """Return the largest absolute change of a class's mask AP50, in points."""
    changes = [
        abs(after.per_class[label]["ap50_segm"] - row["ap50_segm"])
        for label, row in before.per_class.items()
        if not math.isnan(row["ap50_segm"])
    ]
    return 100 * max(changes)


UNITS = {"old_classes": "1", "add_class_s": "s", "retrain_s": "s"}
LARGEST = ("old_class_change", "old_class_change_retrained")
"""Of these the largest of all runs is reported, not the mean."""


def main(argv: Sequence[str]) -> int:
    """Measure, print and write incremental.json."""
    parser = make_parser("incremental", __doc__)
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--train-frames", type=int, default=240, help=f"frames of the {len(TABLETOP)} old objects")
    parser.add_argument("--new-frames", type=int, default=36, help="frames of the new object")
    parser.add_argument("--test-frames", type=int, default=120)
    parser.add_argument("--overrides", nargs="*", default=[], help="of the configuration: segmenter.mode=faithful ...")
    parser.add_argument("--fresh", action="store_true", help="measure again what was measured before")
    parser.add_argument("--work", type=Path, default=work_folder("incremental"), help="folder of the runs")
    options = parser.parse_args(argv)
    console = Console(stderr=True)
    runs = []
    try:
        with Progress(console=console) as progress:
            for seed in range(options.runs):
                runs.append(kept_or_run(options, seed, progress))
    except KeyboardInterrupt:
        console.print("stopped; the same line resumes after the last finished run")
        return 130
    figures = {}
    for key in runs[0]:
        values = [found[key] for found in runs]
        value = max(values) if key in LARGEST else statistics.mean(values)
        spread = statistics.stdev(values) if len(values) > 1 else None
        figures[f"incremental.{key}"] = Figure(value, UNITS.get(key, "points"), spread, len(values))
        console.print(f"incremental.{key:32s} {value:9.3f}", highlight=False)
    write_figures(options.results / "incremental.json", figures, command=command_line("incremental", argv))
    return 0
