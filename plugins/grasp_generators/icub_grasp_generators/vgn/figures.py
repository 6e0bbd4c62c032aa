"""Figures of classifiers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def area_under_curve(score: NDArray[np.floating], label: NDArray[np.bool_]) -> float:
    """Return how often a trial that held (of label (N,)) has a higher score (N,) than one that did not."""
    ranks = np.argsort(np.argsort(score)) + 1.0
    won, lost = int(label.sum()), int((~label).sum())
    return float((ranks[label].sum() - won * (won + 1) / 2) / (won * lost))
