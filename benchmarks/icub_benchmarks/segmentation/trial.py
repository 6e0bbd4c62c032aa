"""One trial of a segmenter on a data set: teach the training frames, examine on the test frames, time the parts."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

from icub_benchmarks.segmentation.voc import RULES, evaluate_voc
from icub_core.data import Instance
from icub_core.errors import DataError
from icub_core.interfaces.dataset import Dataset
from icub_core.interfaces.segmenter import Segmenter
from icub_support.detection import DetectionMetrics, evaluate_instances

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Trial:
    """What one trial measured.

    Attributes:
        metrics: The four mAPs and the APs by class.
        feature_seconds: Wall time of all `observe` calls (on the robot it passes while frames arrive).
        update_seconds: Wall time of `update`: what one waits for after the last frame.
        parts: Seconds within the update by part, such as ``rpn``, ``detection``, ``masks``, as the segmenter says.
        segment_seconds: Mean wall time of finding the objects in one test frame.
        train_frames, test_frames: Frames that were read.
        voc: The four means by PASCAL VOC's rules, by the name of the rule (see `icub_benchmarks.segmentation.voc`).
    """

    metrics: DetectionMetrics
    feature_seconds: float
    update_seconds: float
    parts: dict[str, float] = field(default_factory=dict)
    segment_seconds: float = 0.0
    train_frames: int = 0
    test_frames: int = 0
    voc: dict[str, dict[str, float]] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Trial:
        """Rebuild what `as_dict` gave."""
        return cls(**{**content, "metrics": DetectionMetrics(**content["metrics"])})


def run_trial(segmenter: Segmenter, train: Dataset, test: Dataset, progress: Progress) -> Trial:
    """Teach `segmenter` the frames of `train` in order, update once, and examine it on `test`.

    Reading or rendering frames is not timed. Classes that were never annotated in `train` are not examined.

    Raises:
        DataError: No training frame shows an object, or there is no test frame.
    """
    feature_seconds, taught, taught_classes = 0.0, 0, set[str]()
    for frame, instances in train:
        start = time.perf_counter()
        segmenter.observe(frame, instances)
        feature_seconds += time.perf_counter() - start
        taught += 1
        taught_classes.update(i.label for i in instances)
        progress(0.5 * taught / len(train), f"taught {taught} of {len(train)} frames")
    if not taught_classes:
        raise DataError(f"none of the {taught} training frames shows an object; expected at least one instance")

    progress(0.5, "training")
    start = time.perf_counter()
    report = segmenter.update()
    update_seconds = time.perf_counter() - start

    truth: list[tuple[Instance, ...]] = []
    found: list[tuple[Instance, ...]] = []
    segment_seconds = 0.0
    for frame, instances in test:
        start = time.perf_counter()
        found.append(tuple(segmenter.segment(frame)))
        segment_seconds += time.perf_counter() - start
        truth.append(instances)
        progress(0.5 + 0.5 * len(found) / len(test), f"examined {len(found)} of {len(test)} frames")
    if not found:
        raise DataError("the test set has no readable frame; expected at least one")
    examined = [name for name in train.classes if name in taught_classes]
    return Trial(
        metrics=evaluate_instances(truth, found, examined),
        feature_seconds=feature_seconds,
        update_seconds=update_seconds,
        parts=dict(report.parts),
        segment_seconds=segment_seconds / len(found),
        train_frames=taught,
        test_frames=len(found),
        voc={rule: evaluate_voc(truth, found, examined, rule).as_dict() for rule in RULES},
    )
