"""Quality of region proposals: recall, and its average over overlaps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from icub_core.errors import DataError
from icub_core.geometry import FloatArray
from icub_support.overlap import box_iou


def best_overlaps(truth: Sequence[FloatArray], proposals: Sequence[FloatArray], top: int | None = None) -> FloatArray:
    """Return, for every true box of every image, its largest IoU with the first `top` proposals: (boxes,).

    Args:
        truth: (G, 4) boxes of each image, x0 y0 x1 y1, exclusive ends; G may be 0.
        proposals: (P, 4) boxes of each image, best first; P may be 0.
        top: How many proposals count; all of them when None.

    Raises:
        DataError: The two lists differ in length.
    """
    if len(truth) != len(proposals):
        raise DataError(f"proposals of {len(proposals)} images for the boxes of {len(truth)}; expected equally many")
    best = [
        box_iou(true, proposed[:top]).max(axis=1) if len(proposed[:top]) else np.zeros(len(true))
        for true, proposed in zip(truth, proposals, strict=True)
        if len(true)
    ]
    return np.concatenate(best) if best else np.zeros(0)


def recall(best: FloatArray, iou: float) -> float:
    """Return the share of true boxes with a best overlap of at least `iou`; NaN without boxes."""
    return float(np.mean(best >= iou)) if len(best) else float("nan")


def average_recall(best: FloatArray) -> float:
    """Average the recall over IoU from 0.5 to 1: AR = 2 mean(max(best - 0.5, 0)); NaN without boxes.

    Source: Hosang et al., What makes for effective detection proposals?, 2016, section 4.3.
    """
    return float(2.0 * np.mean(np.maximum(best - 0.5, 0.0))) if len(best) else float("nan")
