"""On-line region proposals: what the two ways of learning them have in common (thesis 11.3.2).

Anchors of the network's cells are scored by classifiers that were trained on the taught objects, and moved by one
regressor per anchor type. `FaithfulRpn` and `SharedRpn` differ in how the classifiers are trained.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import torch
from torchvision.ops import nms

from icub_core.errors import CheckpointError, DataError, NotFittedError
from icub_core.interfaces.abilities import ProposesCells
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures, RpnCells
from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.boxes import clip, decode, encode
from icub_segmenters.heads.rls import Rls
from icub_segmenters.minibootstrap import MakeHead, Minibootstrap
from icub_segmenters.normalization import Normalization
from icub_segmenters.sampling import sample_per_group
from icub_support.weights import part, with_prefix

BEFORE_NMS, NMS_IOU = 1000, 0.7
NO_CLASSIFIER = float("-inf")
"""Score of an anchor whose type has no classifier: it proposes nothing."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Cells with the anchor type and image they were kept for, in the order in which they came.

    Attributes:
        features: (n, f).
        types: (n,) int64.
        image: (n,) int64.
        values: (n, k) what is to be predicted, where that is not the type alone.
    """

    features: torch.Tensor
    types: torch.Tensor
    image: torch.Tensor
    values: torch.Tensor | None = None

    def __len__(self) -> int:
        return len(self.types)

    def take(self, rows: torch.Tensor) -> Rows:
        """Return the rows of numbers (m,)."""
        values = None if self.values is None else self.values[rows]
        return Rows(self.features[rows], self.types[rows], self.image[rows], values)

    @classmethod
    def joined(cls, parts: list[Rows]) -> Rows:
        """Concatenate parts, at least one."""
        values = [p.values for p in parts if p.values is not None]
        columns = [torch.cat([getattr(p, name) for p in parts]) for name in ("features", "types", "image")]
        return cls(columns[0], columns[1], columns[2], torch.cat(values) if values else None)


class OnlineRpn(ABC):
    """Collects cells while images come, trains heads on them, proposes regions.

    A subclass names the tables of rows it keeps in TABLES (``regressed`` among them), fills them in `_keep`, and turns
    them into heads in `_train_classifiers`.
    """

    TABLES: tuple[str, ...] = ("regressed",)
    box_penalty: float
    """Of the regressors on features of norm 20."""

    def __init__(self, make_head: MakeHead, minibootstrap: Minibootstrap, proposals: int = 100) -> None:
        """Configure; nothing is trained.

        Args:
            make_head: Gives an untrained classifier.
            minibootstrap: Numbers of the Minibootstrap.
            proposals: Regions kept per image after suppression at IoU 0.7.
        """
        self.make_head, self.minibootstrap, self.proposals = make_head, minibootstrap, proposals
        self.images = 0
        self.tables: dict[str, list[Rows]] = {name: [] for name in self.TABLES}
        self.normalization: Normalization | None = None
        self.heads: dict[int, OnlineHead] = {}
        self.regressors: dict[int, Rls] = {}

    def observe(self, cells: RpnCells, truth: torch.Tensor, size: tuple[int, int], generator: torch.Generator) -> None:
        """Keep what the cells of one image (height, width) teach about true boxes (m, 4)."""
        self._keep(cells, truth, size, generator)
        self.images += 1

    def train(self, generator: torch.Generator) -> None:
        """Train classifiers and regressors of every anchor type with a positive; other types propose no region."""
        if self.images == 0:
            raise NotFittedError("the region proposal network has seen no image")
        self.normalization, self.heads = self._train_classifiers(generator)
        regressed = Rows.joined(self.tables["regressed"])
        self.regressors = {}
        for kind in regressed.types.unique().tolist():
            own = regressed.types == kind
            assert regressed.values is not None
            self.regressors[kind] = Rls(penalty=self.box_penalty)
            self.regressors[kind].fit(self.normalization(regressed.features[own]), regressed.values[own])

    def propose(self, cells: RpnCells, size: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
        """Return proposals (P, 4) and their scores (P,), best first, of an image (height, width)."""
        if self.normalization is None:
            raise NotFittedError("the region proposal network was asked before it was trained")
        X = self.normalization(cells.features)
        scores = self._scores(cells, X).flatten()
        found = min(BEFORE_NMS, int((scores > NO_CLASSIFIER).sum()))
        score, best = scores.topk(found)
        kinds, cell = cells.types.flatten()[best], best // cells.types.shape[1]
        boxes = cells.anchors.reshape(-1, 4)[best]
        for kind in kinds.unique().tolist():
            if kind in self.regressors:
                own = kinds == kind
                boxes[own] = decode(boxes[own], self.regressors[kind].decision_function(X[cell[own]]), size)
        kept = nms(boxes, score, NMS_IOU)[: self.proposals]
        return boxes[kept], score[kept]

    def fresh(self) -> OnlineRpn:
        """Return an untrained one of the same configuration."""
        return type(self)(self.make_head, self.minibootstrap, self.proposals)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return heads, scale and kept cells, by dotted name."""
        state: dict[str, torch.Tensor] = {"images": torch.tensor(self.images)}
        if self.normalization is not None:
            state["mean"] = self.normalization.mean
            state["mean_norm"] = torch.tensor(self.normalization.mean_norm, dtype=torch.float64)
        for name, heads in (("head", self.heads), ("regressor", self.regressors)):
            for kind, head in heads.items():
                state |= with_prefix(f"{name}.{kind}", head.state_dict())
        for name, parts in self.tables.items():
            if parts:
                rows = Rows.joined(parts)
                state |= {f"{name}.features": rows.features, f"{name}.types": rows.types, f"{name}.image": rows.image}
                if rows.values is not None:
                    state[f"{name}.values"] = rows.values
        return state

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Load what `state_dict` returned; CheckpointError, and nothing changes, for anything else."""
        loaded: dict[str, dict[int, OnlineHead]] = {"head": {}, "regressor": {}}
        tables: dict[str, list[Rows]] = {name: [] for name in self.TABLES}
        try:
            images = int(state["images"])
            normalization = None
            if "mean" in state:
                normalization = Normalization(state["mean"].clone(), float(state["mean_norm"]))
            for name, kind in sorted({tuple(k.split(".")[:2]) for k in state if k.split(".")[0] in loaded}):
                head = self.make_head() if name == "head" else Rls(penalty=self.box_penalty)
                head.load_state_dict(part(state, f"{name}.{kind}"))
                loaded[name][int(kind)] = head
            for name in self.TABLES if images else ():
                features, types, image = (
                    state[f"{name}.{column}"].clone() for column in ("features", "types", "image")
                )
                tables[name] = [Rows(features, types, image, state.get(f"{name}.values"))]
        except (KeyError, ValueError) as error:
            raise CheckpointError(f"this is no region proposal network's state: {error}") from error
        self.images, self.normalization, self.heads, self.tables = images, normalization, loaded["head"], tables
        self.regressors = {kind: head for kind, head in loaded["regressor"].items() if isinstance(head, Rls)}

    @abstractmethod
    def _keep(self, cells: RpnCells, truth: torch.Tensor, size: tuple[int, int], generator: torch.Generator) -> None:
        """Add what one image teaches to the tables."""

    @abstractmethod
    def _train_classifiers(self, generator: torch.Generator) -> tuple[Normalization, dict[int, OnlineHead]]:
        """Return the scale of features and the classifiers."""

    @abstractmethod
    def _scores(self, cells: RpnCells, X: torch.Tensor) -> torch.Tensor:
        """Return the scores (L, A) of all anchors from normalized features X (L, f); NO_CLASSIFIER where none is."""

    def _keep_regressed(self, cells: RpnCells, chosen: torch.Tensor, truth: torch.Tensor) -> None:
        """Add anchors of flat numbers (n,) with their true boxes (n, 4) to the regressors' table."""
        anchors = cells.anchors.reshape(-1, 4)[chosen]
        self.tables["regressed"].append(self._rows(cells, chosen, encode(anchors, truth)))

    def _rows(self, cells: RpnCells, chosen: torch.Tensor, values: torch.Tensor | None = None) -> Rows:
        """Return the cells of anchors with flat numbers (n,), cell x anchors per cell + anchor."""
        features = cells.features[chosen // cells.anchors.shape[1]]  # indexing copies: the maps can be forgotten
        return Rows(features, cells.types.flatten()[chosen], torch.full((len(chosen),), self.images), values)


def some_anchors(cells: RpnCells, count: int, size: tuple[int, int], generator: torch.Generator) -> torch.Tensor:
    """Draw about `count` anchors (n, 4), evenly over the types, and cut them to an image of (height, width)."""
    types = cells.types.flatten()
    each = -(-count // len(types.unique()))
    chosen = sample_per_group(torch.arange(len(types)), types, each, generator)
    return clip(cells.anchors.reshape(-1, 4)[chosen], size)


def cells_of(extractor: FeatureExtractor, image: ImageFeatures) -> RpnCells:
    """Return the cells of an image.

    Raises:
        DataError: Their features are not finite.
    """
    assert isinstance(extractor, ProposesCells)
    cells = extractor.rpn_cells(image)
    if not bool(torch.isfinite(cells.features).all()):
        raise DataError("the features of an image's cells are not finite; expected numbers")
    return cells


def with_proposals(rpn: OnlineRpn, extractor: FeatureExtractor, image: ImageFeatures) -> ImageFeatures:
    """Replace the proposals of an image by those of an on-line network."""
    boxes, scores = rpn.propose(cells_of(extractor, image), image.image_size)
    return replace(image, proposals=boxes, scores=scores)
