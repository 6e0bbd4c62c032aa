"""On-line region proposals by Algorithm 2: one Minibootstrap per anchor type.

Source: thesis 11.3.2 and Algorithm 2. Decisions where thesis and released code differ: regressors learn from anchors
of IoU above 0.6, as the thesis says; negatives are drawn without replacement, so that appendix D holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from icub_core.interfaces.feature_extractor import RpnCells
from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.boxes import iou
from icub_segmenters.normalization import Normalization
from icub_segmenters.online_rpn import NO_CLASSIFIER, OnlineRpn, Rows
from icub_segmenters.sampling import quota_per_image, sample, sample_per_group

POSITIVE_IOU, REGRESSED_IOU, NEGATIVE_IOU = 0.7, 0.6, 0.3
MAX_AN_IMAGE = 200
"""Negatives of an anchor type that one image contributes at most, however few images there are."""


@dataclass(frozen=True, eq=False)
class AnchorLabels:
    """The anchors of one image that classifiers and regressors learn from.

    Attributes:
        positive, negative: (n,) flat numbers, cell x anchors per cell + anchor.
        regressed: (n,) flat numbers of anchors that a regressor learns from.
        truth: (n, 4) their true boxes.
    """

    positive: torch.Tensor
    negative: torch.Tensor
    regressed: torch.Tensor
    truth: torch.Tensor


def label_anchors(anchors: torch.Tensor, truth: torch.Tensor, size: tuple[int, int]) -> AnchorLabels:
    """Compare the anchors of an image with its true boxes.

    Anchors that leave the image are not used. Positive: IoU above 0.7 with a true box, and for a true box
    without such an anchor those of highest IoU. Negative: IoU below 0.3 with all true boxes.

    Args:
        anchors: (n, 4).
        truth: (m, 4) true boxes.
        size: Height and width of the image.
    """
    height, width = size
    inside = (anchors[:, 0] >= 0) & (anchors[:, 1] >= 0) & (anchors[:, 2] <= width) & (anchors[:, 3] <= height)
    usable = torch.nonzero(inside).flatten()
    nothing = torch.zeros(0, dtype=torch.int64)
    if len(truth) == 0:
        return AnchorLabels(nothing, usable, nothing, torch.zeros(0, 4))
    highest, best = iou(anchors[usable], truth).max(dim=1)
    positive = (highest > POSITIVE_IOU) | best_of_missed(highest, best, len(truth))
    regressed = positive | (highest > REGRESSED_IOU)
    return AnchorLabels(usable[positive], usable[highest < NEGATIVE_IOU], usable[regressed], truth[best[regressed]])


def best_of_missed(highest: torch.Tensor, best: torch.Tensor, count: int) -> torch.Tensor:
    """Return which anchors (n,) are the best of a true box that no anchor overlaps by more than 0.7.

    Args:
        highest: (n,) largest IoU of each anchor.
        best: (n,) the true box it is with.
        count: Number of true boxes.
    """
    chosen = torch.zeros(len(highest), dtype=torch.bool)
    for number in range(count):
        mine = best == number
        top = highest[mine].max() if bool(mine.any()) else 0.0
        if 0.0 < top <= POSITIVE_IOU:
            chosen |= mine & (highest == top)
    return chosen


class FaithfulRpn(OnlineRpn):
    """One classifier per anchor type, each with its own samples, centers and Minibootstrap."""

    TABLES = ("positives", "negatives", "regressed")
    box_penalty = 0.01  # the thesis's value for normalized features

    def _keep(self, cells: RpnCells, truth: torch.Tensor, size: tuple[int, int], generator: torch.Generator) -> None:
        types = cells.types.flatten()
        labels = label_anchors(cells.anchors.reshape(-1, 4), truth, size)
        self.tables["positives"].append(self._rows(cells, labels.positive))
        self._keep_regressed(cells, labels.regressed, labels.truth)
        most = quota_per_image(self.minibootstrap.budget, self.images + 1)
        drawn = sample_per_group(labels.negative, types[labels.negative], min(most, MAX_AN_IMAGE), generator)
        self.tables["negatives"].append(self._rows(cells, drawn))
        kept = sum(len(rows) for rows in self.tables["negatives"])
        if kept > 1.5 * self.minibootstrap.budget * max(int(types.max()) + 1, 1):
            self._thin_out(self.images + 1, generator)

    def _train_classifiers(self, generator: torch.Generator) -> tuple[Normalization, dict[int, OnlineHead]]:
        self._thin_out(self.images, generator)
        positives, negatives = Rows.joined(self.tables["positives"]), Rows.joined(self.tables["negatives"])
        features = torch.cat([positives.features, negatives.features])
        label = torch.cat([positives.types, torch.full((len(negatives),), -1)])
        normalization = Normalization.of_classes(features, label, generator)
        X = normalization(features)
        heads: dict[int, OnlineHead] = {}
        for kind in positives.types.unique().tolist():
            own = torch.nonzero(positives.types == kind).flatten()
            others = torch.nonzero(negatives.types == kind).flatten()
            others = sample(others, self.minibootstrap.budget, generator) + len(positives)
            head = self.minibootstrap.train_class(self.make_head, X, own, others)
            if head is not None:
                heads[kind] = head
        return normalization, heads

    def _scores(self, cells: RpnCells, X: torch.Tensor) -> torch.Tensor:
        scores = X.new_full(cells.types.shape, NO_CLASSIFIER)
        for kind, head in self.heads.items():
            cell, anchor = torch.nonzero(cells.types == kind, as_tuple=True)
            if len(cell):
                scores[cell, anchor] = head.decision_function(X[cell]).squeeze(1)
        return scores

    def _thin_out(self, images: int, generator: torch.Generator) -> None:
        """Bring every image down to its share of negatives for every anchor type (Algorithm 2)."""
        rows = Rows.joined(self.tables["negatives"])
        quota = quota_per_image(self.minibootstrap.budget, images)
        group = rows.types * (int(rows.image.max()) + 1 if len(rows) else 1) + rows.image
        kept = sample_per_group(torch.arange(len(rows)), group, quota, generator).sort().values
        self.tables["negatives"] = [rows.take(kept)]
