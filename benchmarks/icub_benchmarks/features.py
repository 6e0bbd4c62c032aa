"""The shipped feature extractor: quality on the FEATURE-TASK, proposals on new objects, time per frame.

Proposals on new objects are measured twice: the extractor's own, and those of on-line region proposal networks (one for
all anchor types of a cell, and Algorithm 2 with one per anchor type), which are taught frames of these objects.

    icub benchmark features
    icub benchmark features --frames 300 --new-frames 200

Rendered frames are kept in the user's cache folder and made when they are missing.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rich.progress import Progress, TaskID

from icub_benchmarks.figures import Figure
from icub_benchmarks.results import command_line, make_parser, write_figures
from icub_core.construct import build
from icub_core.interfaces.dataset import Dataset
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures
from icub_segmenters.faithful_rpn import FaithfulRpn
from icub_segmenters.feature_extractors.compact import CompactMaskRcnn
from icub_segmenters.feature_extractors.evaluation import feature_task_precision, proposal_recall
from icub_segmenters.minibootstrap import Minibootstrap
from icub_segmenters.online_rpn import OnlineRpn, cells_of, with_proposals
from icub_segmenters.shared_rpn import SharedRpn

NEW_OBJECTS = "rendered_tabletop"
WAYS: dict[str, type[OnlineRpn]] = {"online_rpn": SharedRpn, "online_rpn_faithful": FaithfulRpn}


def milliseconds(call: Callable[[], object], repetitions: int) -> Figure:
    """Median and half interquartile range of the processor time of a call on one thread."""
    call()
    times = []
    for _ in range(repetitions):
        begun = time.process_time()
        call()
        times.append(1000 * (time.process_time() - begun))
    low, _, high = statistics.quantiles(times, n=4)
    return Figure(statistics.median(times), "ms", (high - low) / 2, repetitions)


class WithProposals(FeatureExtractor):
    """Another extractor, whose proposals are those of an on-line network."""

    def __init__(self, whole: FeatureExtractor, rpn: OnlineRpn) -> None:
        self._whole, self._rpn = whole, rpn

    region_dim = property(lambda self: self._whole.region_dim)
    mask_dim = property(lambda self: self._whole.mask_dim)
    mask_size = property(lambda self: self._whole.mask_size)

    def extract(self, rgb: NDArray[np.uint8]) -> ImageFeatures:
        """Extract as the whole does, and propose on-line."""
        features = self._whole.extract(rgb)
        return with_proposals(self._rpn, self._whole, features)

    def region_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Describe boxes as the whole does."""
        return self._whole.region_features(features, boxes)

    def mask_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Describe pixels as the whole does."""
        return self._whole.mask_features(features, boxes)


def taught_rpns(
    extractor: FeatureExtractor, data: Dataset, progress: Callable[[float], None]
) -> tuple[dict[str, OnlineRpn], dict[str, float]]:
    """Return on-line networks that were taught all frames of `data`, and the seconds of their training."""
    rpns = {name: way(lambda: build("online_head", "falkon"), Minibootstrap()) for name, way in WAYS.items()}
    for number, (frame, instances) in enumerate(data):
        features = extractor.extract(frame.rgb)
        cells = cells_of(extractor, features)
        truth = torch.tensor(np.array([i.box for i in instances]), dtype=torch.float32).reshape(-1, 4)
        for rpn in rpns.values():
            rpn.observe(cells, truth, features.image_size, torch.Generator().manual_seed(number))
        progress((number + 1) / len(data))
    times = {}
    for name, rpn in rpns.items():
        begun = time.perf_counter()
        rpn.train(torch.Generator().manual_seed(0))
        times[name] = time.perf_counter() - begun
    return rpns, times


def share_of(progress: Progress, line: TaskID) -> Callable[[float], None]:
    """Return a callback that shows a share in a line."""
    return lambda share: progress.update(line, completed=share)


def main(argv: Sequence[str]) -> None:
    """Measure and write features.json."""
    parser = make_parser("features", __doc__)
    parser.add_argument("--weights", default="compact")
    parser.add_argument("--frames", type=int, default=400, help="validation frames of the FEATURE-TASK")
    parser.add_argument("--new-frames", type=int, default=100, help=f"test frames of {NEW_OBJECTS}")
    parser.add_argument("--taught-frames", type=int, default=160, help="frames the on-line networks learn from")
    parser.add_argument("--data", type=Path, help="folder of the FEATURE-TASK's frames")
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    extractor = CompactMaskRcnn(options.weights)
    known = build("dataset", "feature_task", path=options.data, split="validation", frames=options.frames)
    new = build("dataset", NEW_OBJECTS, split="test", frames=options.new_frames)
    figures: dict[str, Figure] = {}
    with Progress() as progress:
        task = progress.add_task("rendering", total=None)
        known.prepare(lambda ready, wanted: progress.update(task, completed=ready, total=wanted))
        for title, prefix, measure, data, count in (
            ("mAP of the FEATURE-TASK", "feature_task", feature_task_precision, known, options.frames),
            ("its proposals", "feature_task", proposal_recall, known, options.frames),
            ("proposals of new objects", "new_objects", proposal_recall, new, options.new_frames),
        ):
            task = progress.add_task(title, total=1.0)
            found = measure(extractor, data, count, share_of(progress, task))
            figures |= {f"{prefix}.{key}": Figure(value, "1", n=count) for key, value in found.items()}
        task = progress.add_task("teaching on-line networks", total=1.0)
        training_images = build("dataset", NEW_OBJECTS, split="train", frames=options.taught_frames)
        rpns, times = taught_rpns(extractor, training_images, share_of(progress, task))
        for name, rpn in rpns.items():
            task = progress.add_task(f"their proposals: {name}", total=1.0)
            own = WithProposals(extractor, rpn)
            found = proposal_recall(own, new, options.new_frames, share_of(progress, task))
            figures |= {f"{name}.{key}": Figure(value, "1", n=options.new_frames) for key, value in found.items()}
            figures[f"{name}.train_s"] = Figure(times[name], "s")
    image = np.asarray(known[0][0].rgb)
    features = extractor.extract(image)
    figures |= {
        "features.extract_ms": milliseconds(lambda: extractor.extract(image), 40),
        "features.regions_100_ms": milliseconds(lambda: extractor.region_features(features, features.proposals), 40),
        "features.masks_5_ms": milliseconds(lambda: extractor.mask_features(features, features.proposals[:5]), 40),
    }
    write_figures(options.results / "features.json", figures, command=command_line("features", argv))
