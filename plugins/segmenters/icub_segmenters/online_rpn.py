"""On-line region proposals: one classifier and one box regressor an anchor type, trained on the taught objects.

Source: thesis 11.3.2 and Algorithm 2. Decisions where thesis and released code differ: regressors learn from anchors
of IoU above 0.6, as the thesis says; negatives are drawn without replacement, so that appendix D holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torchvision.ops import batched_nms

from icub_core.errors import CheckpointError, NotFittedError
from icub_core.interfaces.feature_extractor import RpnCells
from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.boxes import decode, encode, iou
from icub_segmenters.heads.rls import Rls
from icub_segmenters.minibootstrap import MakeHead, Minibootstrap
from icub_segmenters.normalization import Normalization
from icub_segmenters.sampling import quota_per_image, sample, sample_per_group

POSITIVE_IOU, REGRESSED_IOU, NEGATIVE_IOU = 0.7, 0.6, 0.3
BEFORE_NMS, NMS_IOU = 1000, 0.7
BOX_PENALTY = 0.01
"""lambda of the regressors on features of norm 20 (the thesis's value for normalised features)."""


@dataclass(frozen=True, eq=False)
class AnchorLabels:
    """What one image teaches: rows of (cell, anchor of the cell).

    Attributes:
        positive, negative: (n,) flat numbers, cell x anchors a cell + anchor.
        regressed: (n,) flat numbers of anchors that a regressor learns from.
        truth: (n, 4) their true boxes.
    """

    positive: torch.Tensor
    negative: torch.Tensor
    regressed: torch.Tensor
    truth: torch.Tensor


def label_anchors(anchors: torch.Tensor, truth: torch.Tensor, size: tuple[int, int]) -> AnchorLabels:
    """Compare the anchors of an image with its true boxes.

    An anchor that leaves the image teaches nothing. Positive: IoU above 0.7 with a true box, and for a true box
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
    overlap = iou(anchors[usable], truth)
    highest, best = overlap.max(dim=1)
    positive = highest > POSITIVE_IOU
    for number in range(len(truth)):
        mine = best == number
        if bool(mine.any()) and not bool((positive & mine).any()):
            positive |= mine & (highest == highest[mine].max()) & (highest > 0)
    regressed = positive | (highest > REGRESSED_IOU)
    return AnchorLabels(usable[positive], usable[highest < NEGATIVE_IOU], usable[regressed], truth[best[regressed]])


class OnlineRpn:
    """Collects cells while images come, trains one classifier and one regressor an anchor type, proposes regions."""

    def __init__(self, make_head: MakeHead, procedure: Minibootstrap, proposals: int = 100) -> None:
        """Configure; nothing is trained.

        Args:
            make_head: Gives an untrained classifier.
            procedure: Numbers of the Minibootstrap, for each anchor type.
            proposals: Regions kept an image after suppression at IoU 0.7.
        """
        self.make_head, self.procedure, self.proposals = make_head, procedure, proposals
        self.images = 0
        self.positives: list[_Rows] = []
        self.negatives: list[_Rows] = []
        self.regressed: list[_Rows] = []
        self.normalization: Normalization | None = None
        self.heads: dict[int, OnlineHead] = {}
        self.regressors: dict[int, Rls] = {}

    def observe(self, cells: RpnCells, truth: torch.Tensor, size: tuple[int, int], generator: torch.Generator) -> None:
        """Keep what the cells of one image teach about true boxes (m, 4)."""
        count = cells.anchors.shape[1]
        anchors, types = cells.anchors.reshape(-1, 4), cells.types.flatten()
        labels = label_anchors(anchors, truth, size)

        def rows(chosen: torch.Tensor, deltas: torch.Tensor | None = None) -> _Rows:
            image = torch.full((len(chosen),), self.images)
            return _Rows(cells.features[chosen // count].clone(), types[chosen], image, deltas)

        self.positives.append(rows(labels.positive))
        self.regressed.append(rows(labels.regressed, encode(anchors[labels.regressed], labels.truth)))
        most = quota_per_image(self.procedure.budget, self.images + 1)
        drawn = sample_per_group(labels.negative, types[labels.negative], min(most, MOST_AN_IMAGE), generator)
        self.negatives.append(rows(drawn))
        self.images += 1
        if sum(len(r) for r in self.negatives) > 1.5 * self.procedure.budget * max(int(types.max()) + 1, 1):
            self._thin_out(generator)

    def train(self, generator: torch.Generator) -> None:
        """Train every anchor type that has a positive; the others propose nothing."""
        if self.images == 0:
            raise NotFittedError("the region proposal network has seen no image")
        self._thin_out(generator)
        positives, negatives = _joined(self.positives), _joined(self.negatives)
        X = torch.cat([positives.features, negatives.features])
        label = torch.cat([positives.types, torch.full((len(negatives),), -1)])
        self.normalization = Normalization.of_classes(X, label, generator)
        X = self.normalization(X)
        heads: dict[int, OnlineHead] = {}
        for kind in positives.types.unique().tolist():
            own = torch.nonzero(positives.types == kind).flatten()
            others = torch.nonzero(negatives.types == kind).flatten()
            others = sample(others, self.procedure.budget, generator) + len(positives)
            head = self.procedure.train_class(self.make_head, X, own, others)
            if head is not None:
                heads[kind] = head
        self.heads = heads
        regressed = _joined(self.regressed)
        self.regressors = {}
        for kind in regressed.types.unique().tolist():
            own = regressed.types == kind
            assert regressed.deltas is not None
            self.regressors[kind] = Rls(lam=BOX_PENALTY)
            self.regressors[kind].fit(self.normalization(regressed.features[own]), regressed.deltas[own])

    def propose(self, cells: RpnCells, size: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
        """Return proposals (P, 4) and their scores (P,), best first, of an image (height, width)."""
        if self.normalization is None:
            raise NotFittedError("the region proposal network was asked before it was trained")
        X = self.normalization(cells.features)
        boxes, scores, kinds = [], [], []
        for kind, head in self.heads.items():
            cell, anchor = torch.nonzero(cells.types == kind, as_tuple=True)
            if len(cell) == 0:
                continue
            score = head.decision_function(X[cell]).squeeze(1)
            best = score.topk(min(BEFORE_NMS, len(score))).indices
            cell, anchor = cell[best], anchor[best]
            at = cells.anchors[cell, anchor]
            if kind in self.regressors:
                at = decode(at, self.regressors[kind].decision_function(X[cell]), size)
            boxes.append(at)
            scores.append(score[best])
            kinds.append(torch.zeros(len(best), dtype=torch.int64))
        if not boxes:
            return torch.zeros(0, 4), torch.zeros(0)
        box, score = torch.cat(boxes), torch.cat(scores)
        best = score.topk(min(BEFORE_NMS, len(score))).indices
        box, score = box[best], score[best]
        kept = batched_nms(box, score, torch.zeros(len(box), dtype=torch.int64), NMS_IOU)[: self.proposals]
        return box[kept], score[kept]

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return heads, scale and kept cells, by dotted name."""
        state: dict[str, torch.Tensor] = {"images": torch.tensor(self.images)}
        if self.normalization is not None:
            state["mean"] = self.normalization.mean
            state["mean_norm"] = torch.tensor(self.normalization.mean_norm, dtype=torch.float64)
        for name, heads in (("head", self.heads), ("regressor", self.regressors)):
            for kind, head in heads.items():
                state |= {f"{name}.{kind}.{key}": value for key, value in head.state_dict().items()}
        for name in ("positives", "negatives", "regressed"):
            if getattr(self, name):
                rows = _joined(getattr(self, name))
                state |= {f"{name}.features": rows.features, f"{name}.types": rows.types, f"{name}.image": rows.image}
                if rows.deltas is not None:
                    state[f"{name}.deltas"] = rows.deltas
        return state

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Take over what `state_dict` gave; CheckpointError, and nothing changes, when it is not that."""
        loaded: dict[str, dict[int, OnlineHead]] = {"head": {}, "regressor": {}}
        kept: dict[str, list[_Rows]] = {}
        try:
            images = int(state["images"])
            normalization = None
            if "mean" in state:
                normalization = Normalization(state["mean"].clone(), float(state["mean_norm"]))
            for name, kind in sorted({tuple(k.split(".")[:2]) for k in state if k.split(".")[0] in loaded}):
                prefix = f"{name}.{kind}."
                head = self.make_head() if name == "head" else Rls(lam=BOX_PENALTY)
                head.load_state_dict({k[len(prefix) :]: v for k, v in state.items() if k.startswith(prefix)})
                loaded[name][int(kind)] = head
            for name in ("positives", "negatives", "regressed"):
                if f"{name}.features" in state:
                    features, types, image = (state[f"{name}.{column}"] for column in ("features", "types", "image"))
                    kept[name] = [_Rows(features.clone(), types.clone(), image.clone(), state.get(f"{name}.deltas"))]
        except (KeyError, ValueError) as error:
            raise CheckpointError(f"this is no region proposal network's state: {error}") from error
        self.images, self.normalization, self.heads = images, normalization, loaded["head"]
        self.regressors = {kind: head for kind, head in loaded["regressor"].items() if isinstance(head, Rls)}
        self.positives, self.negatives = kept.get("positives", []), kept.get("negatives", [])
        self.regressed = kept.get("regressed", [])

    def _thin_out(self, generator: torch.Generator) -> None:
        """Bring every image down to its share of negatives for every anchor type (Algorithm 2)."""
        rows = _joined(self.negatives)
        quota = quota_per_image(self.procedure.budget, self.images)
        group = rows.types * (int(rows.image.max()) + 1 if len(rows) else 1) + rows.image
        kept = sample_per_group(torch.arange(len(rows)), group, quota, generator).sort().values
        self.negatives = [rows.take(kept)]


MOST_AN_IMAGE = 200
"""Negatives of an anchor type that one image contributes at most, however few images there are."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Cells with the anchor type and image they were kept for: features (n, f), types, image (n,), deltas (n, 4)."""

    features: torch.Tensor
    types: torch.Tensor
    image: torch.Tensor
    deltas: torch.Tensor | None = None

    def __len__(self) -> int:
        return len(self.types)

    def take(self, rows: torch.Tensor) -> _Rows:
        deltas = None if self.deltas is None else self.deltas[rows]
        return _Rows(self.features[rows], self.types[rows], self.image[rows], deltas)


def _joined(parts: list[_Rows]) -> _Rows:
    deltas = [p.deltas for p in parts if p.deltas is not None]
    return _Rows(
        torch.cat([p.features for p in parts]),
        torch.cat([p.types for p in parts]),
        torch.cat([p.image for p in parts]),
        torch.cat(deltas) if deltas else None,
    )
