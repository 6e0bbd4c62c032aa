"""Average precision by the PASCAL VOC rules, with the matching of the thesis's evaluation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance
from icub_core.errors import ConfigError, unknown_name
from icub_support.detection import IOU_THRESHOLDS, DetectionMetrics, metrics_from_per_class
from icub_support.overlap import box_iou, boxes_of, check_image_lists, mask_iou

FloatArray = NDArray[np.float64]
Rule = Literal["11-point", "area"]
RULES: tuple[Rule, ...] = ("11-point", "area")


def average_precision(recall: FloatArray, precision: FloatArray, rule: Rule = "11-point") -> float:
    """Summarize a precision-recall curve, points ordered by falling score.

    Args:
        recall: (n,) not falling, 0 to 1.
        precision: (n,) 0 to 1.
        rule: ``"11-point"``: mean of max {precision : recall >= t} over t = 0, 0.1, ..., 1 (VOC2007). ``"area"``: area
            under the curve after making precision not rise with recall (VOC2010).
    """
    if rule not in RULES:
        raise ConfigError(unknown_name("average-precision rule", rule, RULES))
    # best precision from each point on; a final 0 stands for the recalls that are never reached
    envelope = np.append(np.maximum.accumulate(precision[::-1])[::-1], 0.0)
    if rule == "11-point":
        # tenths as k/10: 0.1 * 3 is a bit above 0.3 and would miss a recall of exactly 3 of 10
        at = np.searchsorted(recall, np.arange(11) / 10, side="left")
        return float(envelope[at].mean())
    steps = np.diff(recall, prepend=0.0)
    return float((steps * envelope[:-1]).sum())


def evaluate_voc(
    truth: Sequence[Sequence[Instance]],
    predictions: Sequence[Sequence[Instance]],
    classes: Sequence[str],
    rule: Rule = "11-point",
) -> DetectionMetrics:
    """Like `evaluate_instances`, by VOC's rules.

    A prediction goes to the true instance of its class that it overlaps most, taken or not: a second hit on the same
    instance is a false positive, and does not fall back to another one (COCO's does). There is no limit on the number
    of predictions. The thesis names the metric of VOC2010 (area); the released evaluation uses 11 points, which is
    therefore the default. The released code's extra pixel in the IoU of inclusive boxes is not repeated.

    Args:
        truth: True instances, one sequence per image; labels outside `classes` are not evaluated.
        predictions: Predicted instances, same images, same order.
        classes: What is evaluated.
        rule: See `average_precision`.

    Returns:
        The metrics; NaN for classes (or means) without truth.

    Raises:
        ConfigError: Unknown rule.
        DataError: See `icub_support.overlap.check_image_lists`.

    Source: thesis 10.4.1 and 11.4.1; Everingham et al., The PASCAL Visual Object Classes Challenge, 2010, section 4.2.
    """
    if rule not in RULES:
        raise ConfigError(unknown_name("average-precision rule", rule, RULES))
    check_image_lists(truth, predictions, classes)
    count = {label: sum(i.label == label for image in truth for i in image) for label in classes}
    per_class: dict[str, dict[str, float]] = {}
    for label in classes:
        row = {f"ap{round(100 * t)}_{kind}": math.nan for kind in ("segm", "bbox") for t in IOU_THRESHOLDS}
        if count[label]:
            for kind in ("segm", "bbox"):
                scores, best, overlap = _best_matches(truth, predictions, label, kind)
                for threshold in IOU_THRESHOLDS:
                    curve = _curve(scores, best, overlap >= threshold, count[label])
                    row[f"ap{round(100 * threshold)}_{kind}"] = average_precision(*curve, rule=rule)
        per_class[label] = row
    return metrics_from_per_class(per_class, count)


def _best_matches(
    truth: Sequence[Sequence[Instance]], predictions: Sequence[Sequence[Instance]], label: str, kind: str
) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
    """Return per prediction: score, most overlapped true instance (numbered over all images), overlap."""
    scores: list[float] = []
    best: list[int] = []
    overlap: list[float] = []
    first = 0
    for true, predicted in zip(truth, predictions, strict=True):
        of_class = [i for i in true if i.label == label]
        found = [i for i in predicted if i.label == label]
        if found and of_class:
            iou = (
                mask_iou([i.mask for i in found], [i.mask for i in of_class])
                if kind == "segm"
                else box_iou(boxes_of(found), boxes_of(of_class))
            )
            best += [first + int(i) for i in iou.argmax(axis=1)]
            overlap += list(iou.max(axis=1))
        else:
            best += [-1] * len(found)
            overlap += [-1.0] * len(found)
        scores += [i.score for i in found]
        first += len(of_class)
    return np.array(scores, dtype=np.float64), np.array(best, dtype=np.intp), np.array(overlap, dtype=np.float64)


def _curve(
    scores: FloatArray, best: NDArray[np.intp], hits: NDArray[np.bool_], positives: int
) -> tuple[FloatArray, FloatArray]:
    """Return (recall, precision) by falling score; of the hits on one instance only the first counts as true."""
    order = np.argsort(-scores, kind="stable")
    hit_rank = np.flatnonzero(hits[order])
    _, first_hit = np.unique(best[order][hit_rank], return_index=True)
    true_positive = np.zeros(len(order))
    true_positive[hit_rank[first_hit]] = 1.0
    found = np.cumsum(true_positive)
    return found / positives, found / np.arange(1, len(order) + 1)
