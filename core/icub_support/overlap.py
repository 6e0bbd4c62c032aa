"""Intersection over union of boxes and of masks, the one measure all metrics here are built on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance
from icub_core.errors import DataError
from icub_core.geometry import FloatArray

Float = TypeVar("Float", np.float32, np.float64)


def box_iou(a: NDArray[Float], b: NDArray[Float]) -> NDArray[Float]:
    """Return the IoU (N, M) of boxes a (N, 4) and b (M, 4), x0 y0 x1 y1 in pixels with x1 and y1 exclusive.

    Exclusive corners make the width x1 - x0; this equals the "+1" rule of integer, inclusive boxes. A box without area
    overlaps nothing.
    """
    return paired_box_iou(a[:, None], b[None])


def paired_box_iou(a: NDArray[Float], b: NDArray[Float]) -> NDArray[Float]:
    """Return the IoU (...) of each box of a (..., 4) with its partner in b (..., 4), as `box_iou`."""
    sides = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    intersection = np.prod(np.clip(sides, 0.0, None), axis=-1)
    area_a, area_b = (np.prod(np.clip(boxes[..., 2:] - boxes[..., :2], 0.0, None), axis=-1) for boxes in (a, b))
    union = area_a + area_b - intersection
    return np.divide(intersection, union, out=np.zeros_like(intersection), where=union > 0)


def mask_iou(a: Sequence[NDArray[np.bool_]], b: Sequence[NDArray[np.bool_]]) -> FloatArray:
    """Return the IoU (N, M) of full-image masks (H, W) bool. An empty mask overlaps nothing."""
    if not len(a) or not len(b):
        return np.zeros((len(a), len(b)))
    # float32 products of zeros and ones are exact up to 2^24 pixels, and far faster than boolean ones
    flat_a = np.stack([m.ravel() for m in a]).astype(np.float32)
    flat_b = np.stack([m.ravel() for m in b]).astype(np.float32)
    intersection = (flat_a @ flat_b.T).astype(np.float64)
    union = flat_a.sum(axis=1)[:, None].astype(np.float64) + flat_b.sum(axis=1)[None, :] - intersection
    return np.divide(intersection, union, out=np.zeros_like(intersection), where=union > 0)


def boxes_of(instances: Sequence[Instance]) -> FloatArray:
    """Stack the boxes of `instances`: (N, 4) float64, also for none."""
    return np.array([i.box for i in instances], dtype=np.float64).reshape(len(instances), 4)


def check_image_lists(
    truth: Sequence[Sequence[Instance]], predictions: Sequence[Sequence[Instance]], classes: Sequence[str]
) -> None:
    """Refuse what no metric can be computed from, naming the image.

    Raises:
        DataError: The two lists differ in length; `classes` repeats a name; a predicted label is not among `classes`; a
            score is not a number; masks of one image differ in size.
    """
    if len(truth) != len(predictions):
        raise DataError(
            f"{len(predictions)} images were predicted but {len(truth)} are annotated; expected equally many"
        )
    if len(set(classes)) != len(classes):
        raise DataError(f"the classes to evaluate repeat a name: {sorted(classes)}")
    known = set(classes)
    for index, (true, predicted) in enumerate(zip(truth, predictions, strict=True)):
        sizes = {i.mask.shape for i in (*true, *predicted)}
        if len(sizes) > 1:
            raise DataError(f"image {index}: masks of different sizes {sorted(sizes)}; expected one size per image")
        for instance in predicted:
            if instance.label not in known:
                raise DataError(
                    f"image {index}: '{instance.label}' was predicted; expected one of {', '.join(classes)}"
                )
            if not np.isfinite(instance.score):
                raise DataError(
                    f"image {index}: the score of '{instance.label}' is {instance.score}; expected a number"
                )
