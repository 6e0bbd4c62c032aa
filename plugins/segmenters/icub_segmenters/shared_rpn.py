"""On-line region proposals for all anchor types of a cell at once: a documented variation, much faster.

The thesis trains one classifier per anchor type (`FaithfulRpn`). With few taught frames many types have hardly a
positive, and their classifiers cannot be compared with one another. Here a cell is a sample, and how well each of its
anchors covers an object is what is predicted: -1 up to an IoU of 0.3, +1 from 0.7, linear between. All types of a
cell share samples, centers and factorization.
"""

from __future__ import annotations

import torch

from icub_core.interfaces.abilities import SharesKernel
from icub_core.interfaces.feature_extractor import RpnCells
from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.boxes import iou
from icub_segmenters.faithful_rpn import NEGATIVE_IOU, POSITIVE_IOU, best_of_missed
from icub_segmenters.normalization import Normalization
from icub_segmenters.online_rpn import NO_CLASSIFIER, OnlineRpn, Rows
from icub_segmenters.sampling import lowest_per_group, quota_per_image

REGRESSED_IOU = 0.5
"""Anchors that overlap a true box by more teach the regressors; from 0.6 on, as in the thesis, they are few."""
MAX_CENTERS = 500
"""Cells have 128 features or so; with 1000 centers recall was the same."""
MAX_AN_IMAGE = 60
"""Cells near objects, and as many others, that an image contributes at most for a group of anchor types."""
SURPLUS = 1.5
"""Kept cells may outgrow the budget by this factor before old images are thinned out."""


class SharedRpn(OnlineRpn):
    """One classifier for all anchor types that occur at the same cells, such as those of a pyramid's level.

    Such a group goes by its first type: cells with the same first type have the same types. Of each image and group a
    uniform sample of the cells near objects is kept, and one of the others, by random numbers that each cell got when
    it came: what is kept is what a batch would keep. Twice as many of the others were measured to add nothing, so hard
    ones are not searched for.
    """

    TABLES = ("near", "far", "regressed")
    box_penalty = 30.0  # with 0.01 a regressor of few anchors fits them to the pixel and misplaces all others

    def _keep(self, cells: RpnCells, truth: torch.Tensor, size: tuple[int, int], generator: torch.Generator) -> None:
        anchors = cells.anchors.reshape(-1, 4)
        targets = torch.full(cells.types.shape, -1.0)
        nothing = torch.zeros(0, dtype=torch.int64)
        regressed, best = nothing, nothing
        if len(truth):
            highest, best = iou(anchors, truth).max(dim=1)
            share = (highest - NEGATIVE_IOU) / (POSITIVE_IOU - NEGATIVE_IOU)
            flat = (2 * share - 1).clamp(-1, 1)
            flat[best_of_missed(highest, best, len(truth))] = 1.0
            targets = flat.view(cells.types.shape)
            regressed = torch.nonzero(highest > REGRESSED_IOU).flatten()
        self._keep_regressed(cells, regressed, truth[best[regressed]])
        # the last column is the priority
        values = torch.cat([targets, torch.rand(len(targets), 1, generator=generator)], dim=1)
        is_near = (targets > -1).any(dim=1)
        first = torch.arange(len(targets)) * cells.types.shape[1]
        quota = quota_per_image(self.minibootstrap.budget, self.images + 1)
        for name, chosen in (("near", is_near), ("far", ~is_near)):
            rows = self._rows(cells, first[chosen], values[chosen])
            self.tables[name].append(rows.take(_lowest(rows, min(quota, MAX_AN_IMAGE))))
            groups = len(cells.types[:, 0].unique())
            if sum(map(len, self.tables[name])) > SURPLUS * self.minibootstrap.budget * groups:
                self._thin_out(name, self.images + 1)

    def _train_classifiers(self, generator: torch.Generator) -> tuple[Normalization, dict[int, OnlineHead]]:
        for name in ("near", "far"):
            self._thin_out(name, self.images)
        near, far = (Rows.joined(self.tables[name]) for name in ("near", "far"))
        rows = Rows.joined([near, far])
        label = torch.cat([near.types, torch.full((len(far),), -1)])
        normalization = Normalization.of_classes(rows.features, label, generator)
        heads: dict[int, OnlineHead] = {}
        assert rows.values is not None
        for group in near.types.unique().tolist():
            own = rows.types == group
            head = self.make_head()
            if isinstance(head, SharesKernel):
                head = head.with_at_most(MAX_CENTERS)
            head.fit(normalization(rows.features[own]), rows.values[own, :-1])
            heads[group] = head
        return normalization, heads

    def _scores(self, cells: RpnCells, X: torch.Tensor) -> torch.Tensor:
        scores = X.new_full(cells.types.shape, NO_CLASSIFIER)
        for group, head in self.heads.items():
            own = cells.types[:, 0] == group
            if bool(own.any()):
                scores[own] = head.decision_function(X[own])
        return scores

    def _thin_out(self, name: str, images: int) -> None:
        """Bring every image down to its share of a table's cells, for every group."""
        rows = Rows.joined(self.tables[name])
        self.tables[name] = [rows.take(_lowest(rows, quota_per_image(self.minibootstrap.budget, images)))]


def _lowest(rows: Rows, count: int) -> torch.Tensor:
    """Choose the `count` rows of lowest priority of every image and group, in their order."""
    assert rows.values is not None
    images = int(rows.image.max()) + 1 if len(rows) else 1
    numbers = torch.arange(len(rows))
    return lowest_per_group(numbers, rows.types * images + rows.image, rows.values[:, -1], count).sort().values
