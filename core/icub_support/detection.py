"""Mean average precision of boxes and masks by the COCO rules, computed by the library faster-coco-eval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from icub_core.data import Instance
from icub_support.overlap import check_image_lists

IOU_THRESHOLDS = (0.5, 0.7)
MAX_DETECTIONS = 100  # an image and class; the thesis keeps 100 an image
EVERY_AREA = [0.0, 1e10]


@dataclass(frozen=True)
class DetectionMetrics:
    """Average precisions, 0 to 1, by the thesis's four names.

    Attributes:
        map50_segm, map70_segm: Mean over the classes that occur in the truth, masks, IoU of at least 0.5 and 0.7.
        map50_bbox, map70_bbox: The same for boxes.
        per_class: Class to ``{"ap50_segm": ..., "ap70_segm": ..., "ap50_bbox": ..., "ap70_bbox": ...}``; NaN for a
            class that never occurs in the truth.
        truth_count: Class to number of annotated instances.
    """

    map50_segm: float
    map70_segm: float
    map50_bbox: float
    map70_bbox: float
    per_class: dict[str, dict[str, float]] = field(default_factory=dict)
    truth_count: dict[str, int] = field(default_factory=dict)

    def as_dict(self, prefix: str = "") -> dict[str, float]:
        """Return the four means as a flat dictionary, such as ``{"segmentation.map50_segm": 0.8, ...}``."""
        return {f"{prefix}{name}": getattr(self, name) for name in MEAN_NAMES}


MEAN_NAMES = ("map50_segm", "map70_segm", "map50_bbox", "map70_bbox")


def metrics_from_per_class(per_class: dict[str, dict[str, float]], truth_count: dict[str, int]) -> DetectionMetrics:
    """Average per-class precisions over the classes that occur; NaN where no class does."""
    means = {}
    for name in MEAN_NAMES:
        values = [row["ap" + name[3:]] for label, row in per_class.items() if truth_count[label]]
        means[name] = float(np.mean(values)) if values else math.nan
    return DetectionMetrics(**means, per_class=per_class, truth_count=truth_count)


def evaluate_instances(
    truth: Sequence[Sequence[Instance]],
    predictions: Sequence[Sequence[Instance]],
    classes: Sequence[str],
) -> DetectionMetrics:
    """Compare predicted with true instances of a list of images: AP at IoU 0.5 and 0.7, boxes and masks.

    COCO's rules: within an image and class predictions are taken by falling score (at most 100); each goes to the
    free true instance it overlaps most, if by at least the threshold; precision is interpolated at 101 recalls.

    Args:
        truth: True instances, one sequence an image. Labels outside `classes` are not evaluated (never taught
            distractors, say); a prediction on top of one is a false positive of the class it names.
        predictions: Predicted instances, same images, same order.
        classes: What is evaluated.

    Returns:
        The metrics. Without a prediction every AP is 0; a class that never occurs in the truth has AP NaN and no part
        in the means, whatever was predicted; with an empty truth the means are NaN.

    Raises:
        DataError: See `icub_support.overlap.check_image_lists`.
    """
    check_image_lists(truth, predictions, classes)
    count = {label: sum(i.label == label for image in truth for i in image) for label in classes}
    per_class = {label: {} for label in classes}  # type: dict[str, dict[str, float]]
    for kind in ("segm", "bbox"):
        precision = _coco_average_precision(truth, predictions, classes, kind)
        for row, label in zip(precision, classes, strict=True):
            for threshold, value in zip(IOU_THRESHOLDS, row, strict=True):
                per_class[label][f"ap{round(100 * threshold)}_{kind}"] = float(value)
    return metrics_from_per_class(per_class, count)


def _coco_average_precision(
    truth: Sequence[Sequence[Instance]],
    predictions: Sequence[Sequence[Instance]],
    classes: Sequence[str],
    kind: str,
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return (classes, thresholds) average precisions, NaN for a class without truth."""
    # imported here so that the core can be imported, and masks be handled, without the library
    from faster_coco_eval import COCO, COCOeval_faster

    category = {label: i + 1 for i, label in enumerate(classes)}
    annotations = [
        {"id": 0, "image_id": image, "category_id": category[i.label], "iscrowd": 0, **_coco_shape(i, kind)}
        for image, instances in enumerate(truth)
        for i in instances
        if i.label in category
    ]
    results = [
        {"image_id": image, "category_id": category[i.label], "score": float(i.score), **_coco_shape(i, kind)}
        for image, instances in enumerate(predictions)
        for i in instances
    ]
    average = np.full((len(classes), len(IOU_THRESHOLDS)), math.nan)
    if not annotations:
        return average
    for number, annotation in enumerate(annotations):
        annotation["id"] = number + 1  # 0 would mean "unmatched" to the library
    if not results:
        average[[category[label] - 1 for label in {i.label for image in truth for i in image} & set(classes)]] = 0.0
        return average
    dataset = {
        "info": {},
        "images": [{"id": i, "height": h, "width": w} for i, (h, w) in enumerate(_image_sizes(truth, predictions))],
        "categories": [{"id": number, "name": label} for label, number in category.items()],
        "annotations": annotations,
    }
    coco_truth = COCO(dataset)
    evaluation = COCOeval_faster(coco_truth, coco_truth.loadRes(results), iouType=kind)
    evaluation.params.iouThrs = np.array(IOU_THRESHOLDS)
    evaluation.params.areaRng = [EVERY_AREA]
    evaluation.params.areaRngLbl = ["all"]
    evaluation.params.maxDets = [MAX_DETECTIONS]
    evaluation.evaluate()
    evaluation.accumulate()
    precision = np.asarray(evaluation.eval["precision"])[:, :, :, 0, 0]  # (thresholds, recalls, classes), -1 unknown
    occurs = (precision >= 0).all(axis=(0, 1))
    average[occurs] = precision[:, :, occurs].mean(axis=1).T
    return average


def _coco_shape(instance: Instance, kind: str) -> dict[str, Any]:
    x0, y0, x1, y1 = (float(v) for v in instance.box)
    bbox = [x0, y0, max(x1 - x0, 0.0), max(y1 - y0, 0.0)]
    if kind == "bbox":
        return {"bbox": bbox, "area": bbox[2] * bbox[3]}
    from faster_coco_eval import mask as rle

    encoded = rle.encode(np.asfortranarray(instance.mask.astype(np.uint8)))
    return {"bbox": bbox, "segmentation": encoded, "area": float(instance.mask.sum())}


def _image_sizes(
    truth: Sequence[Sequence[Instance]], predictions: Sequence[Sequence[Instance]]
) -> list[tuple[int, int]]:
    """Return (height, width) of every image; (1, 1) where nothing is in it, which no metric looks at."""
    sizes: list[tuple[int, int]] = []
    for true, predicted in zip(truth, predictions, strict=True):
        shape = next((i.mask.shape for i in (*true, *predicted)), (1, 1))
        sizes.append((int(shape[0]), int(shape[1])))
    return sizes
