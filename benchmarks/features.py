"""The shipped feature extractor: quality on the FEATURE-TASK, proposals on new objects, time a frame.

    icub benchmark features
    icub benchmark features --frames 300 --new-frames 200

Rendered frames are kept in the user's cache folder and made when they are missing.
"""

from __future__ import annotations

import argparse
import shlex
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from rich.progress import Progress

from icub_core.evaluation.results import Figure, write_results
from icub_core.registry import load
from icub_segmenters.feature_extractors.compact import CompactMaskRcnn
from icub_segmenters.feature_extractors.evaluation import feature_task_precision, proposal_recall

RESULTS = Path(__file__).resolve().parent / "results" / "features.json"
NEW_OBJECTS = "rendered_tabletop"


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


def main() -> None:
    """Measure and write benchmarks/results/features.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", default="compact")
    parser.add_argument("--frames", type=int, default=400, help="validation frames of the FEATURE-TASK")
    parser.add_argument("--new-frames", type=int, default=100, help=f"test frames of {NEW_OBJECTS}")
    parser.add_argument("--data", type=Path, help="folder of the FEATURE-TASK's frames")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    extractor = CompactMaskRcnn(options.weights)
    known = load("dataset", "feature_task")(path=options.data, split="validation", frames=options.frames)
    new = load("dataset", NEW_OBJECTS)(split="test", frames=options.new_frames)
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
            found = measure(extractor, data, count, lambda share, task=task: progress.update(task, completed=share))
            figures |= {f"{prefix}.{key}": Figure(value, "1", n=count) for key, value in found.items()}
    image = np.asarray(known[0][0].rgb)
    features = extractor.extract(image)
    figures |= {
        "features.extract_ms": milliseconds(lambda: extractor.extract(image), 40),
        "features.regions_100_ms": milliseconds(lambda: extractor.region_features(features, features.proposals), 40),
        "features.masks_5_ms": milliseconds(lambda: extractor.mask_features(features, features.proposals[:5]), 40),
    }
    command = shlex.join(["icub", "benchmark", "features", *sys.argv[1:]])
    write_results(options.out, command=command, seed=0, figures=figures)
    print(f"written: {options.out}")


if __name__ == "__main__":
    main()
