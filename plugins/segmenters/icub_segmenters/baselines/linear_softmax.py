"""Baseline: a linear classifier, trained by gradient descent on the same regions as `falkon`."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch.nn import functional

from icub_core.interfaces.feature_extractor import FeatureExtractor
from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.detection import OnlineDetector
from icub_segmenters.online_segmenter import OnlineSegmenter
from icub_segmenters.procedure import Procedure

MIN_LOGIT = -6.0
"""Log odds below which nothing is reported: a probability of 0.002."""


class SoftmaxDetector(OnlineDetector):
    """Scores are a class's log odds against everything else, other classes included, as a softmax layer's are."""

    def scores(self, X: torch.Tensor) -> torch.Tensor:
        """Return scores (n, classes) of normalized features X (n, d), in the order of the softmax probabilities."""
        against_background = super().scores(X)
        logits = torch.cat([against_background.new_zeros(len(X), 1), against_background], dim=1)
        share = functional.log_softmax(logits.double(), dim=1)[:, 1:]
        # log p - log(1 - p), with care where p rounds to 1
        return (share - torch.log(-torch.expm1(share.clamp(max=-1e-12)))).to(against_background)


class LinearSoftmax(OnlineSegmenter):
    """Baseline: linear softmax classifiers trained on the same regions as `falkon`.

    Features, pasted clutter, box regressors and the combination of masks are those of `OnlineSegmenter`; only the
    classifiers differ. Every epoch uses all negatives of the budget, without mining of hard ones, so that a remaining
    difference to `falkon` is due to its kernel.
    """

    detector_type = SoftmaxDetector

    def __init__(
        self,
        feature_extractor: FeatureExtractor,
        online_head: Callable[[], OnlineHead],
        negatives: int = 20_000,
        composites: int = 3,
        masks: str = "combined",
        seed: int = 0,
    ) -> None:
        """Configure; see `OnlineSegmenter`.

        Args:
            feature_extractor: Proposes and describes regions.
            online_head: Gives an untrained classifier whose scores are log odds: ``linear``.
            negatives: Background regions trained on at most.
            composites: Images with pasted clutter made of every observed frame; 0 for none.
            masks: ``"online"``, ``"pretrained"`` or ``"combined"``.
            seed: Decides everything random.
        """
        super().__init__(
            feature_extractor,
            online_head,
            batches=1,
            batch_size=negatives,
            composites=composites,
            masks=masks,
            seed=seed,
            procedure=Procedure(min_score=MIN_LOGIT),
        )
