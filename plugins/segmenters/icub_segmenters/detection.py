"""On-line detection: which taught object is in which region, and where exactly (thesis 11.3.2)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torchvision.ops import batched_nms

from icub_core.errors import CheckpointError, NotFittedError
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures
from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.boxes import decode, encode, iou, paired_iou
from icub_segmenters.heads.rls import Rls
from icub_segmenters.incremental import Addition, add_class, add_together
from icub_segmenters.minibootstrap import MakeHead, Minibootstrap, Rows
from icub_segmenters.normalization import Normalization
from icub_segmenters.procedure import STANDARD
from icub_segmenters.region_store import RegionStore
from icub_segmenters.sampling import class_negatives, later_negatives, sample_per_group, shared_negatives
from icub_support.weights import part, with_prefix

NMS_IOU = 0.3
MAX_OF_A_CLASS = 20
"""The thesis keeps 100 of all classes together: there a class that comes later crowds out the others' last ones."""
NEVER = -2.0
"""Score of a class that cannot be recognized: below what any trained head gives to background."""
BOX_PENALTY = 10.0
"""Of the box regressors on features of norm 20."""
VOTE_SHARPNESS = 4.0
"""A vote weighs exp of this times its score."""
MIN_POSITIVES = 200
"""With all classes on one pool positives number at most as many as the negatives' budget, but a class has so many. Half
as many cost 1.6 points of mAP50 with 21 classes."""
MAX_REGRESSED = 200
"""Positives of a class that its box regressor learns from at most, evenly over time: more were measured to add
nothing, and made half of the training time."""
TIGHT_IOU = 0.75
"""The second regressor learns from regions as close as the first one brings them."""


@dataclass(frozen=True, eq=False)
class Detections:
    """Found objects of one image, best first.

    Attributes:
        boxes: (k, 4) pixels.
        labels: (k,) class numbers.
        scores: (k,).
    """

    boxes: torch.Tensor
    labels: torch.Tensor
    scores: torch.Tensor

    def __len__(self) -> int:
        return len(self.scores)

    def take(self, rows: torch.Tensor) -> Detections:
        """Return the named rows."""
        return Detections(self.boxes[rows], self.labels[rows], self.scores[rows])


class BoxRegressors:
    """One RLS box regressor per class; boxes of a class without samples stay as they are."""

    def __init__(self) -> None:
        self.heads: dict[int, Rls] = {}

    def fit(self, X: Rows, store: RegionStore, min_iou: float, first: int = 0) -> None:
        """Train on the positives of `store` whose IoU with their true box is at least `min_iou`; X (n, d).

        Classes below `first` stay as they are.
        """
        positives = torch.nonzero(store.label >= first).flatten()
        boxes, targets, label = store.boxes[positives], store.targets[positives], store.label[positives]
        size = (boxes[:, 2:] - boxes[:, :2]).prod(dim=1)
        good = (paired_iou(boxes, targets) >= min_iou) & (size > 0)
        heads = {c: head for c, head in self.heads.items() if c < first}
        for c in label[good].unique().tolist():
            of_class = torch.nonzero(good & (label == c)).flatten()
            if len(of_class) > MAX_REGRESSED:
                of_class = of_class[torch.linspace(0, len(of_class) - 1, MAX_REGRESSED).long()]
            head = Rls(penalty=BOX_PENALTY)
            head.fit(X[positives[of_class]], encode(boxes[of_class], targets[of_class]))
            heads[c] = head
        self.heads = heads

    def refine(
        self, X: torch.Tensor, boxes: torch.Tensor, labels: torch.Tensor, image_size: tuple[int, int]
    ) -> torch.Tensor:
        """Return boxes (n, 4) moved by the regressors of their classes (n,), from features X (n, d)."""
        deltas = torch.zeros_like(boxes)
        for c, head in self.heads.items():
            rows = labels == c
            if bool(rows.any()):
                deltas[rows] = head.decision_function(X[rows])
        return decode(boxes, deltas, image_size)


class OnlineDetector:
    """Classifiers by Minibootstrap and box regressors by RLS on a store of regions."""

    def __init__(
        self,
        make_head: MakeHead,
        minibootstrap: Minibootstrap,
        *,
        shared: bool = True,
        repool: bool = True,
        vote_iou: float = STANDARD.vote_iou,
    ) -> None:
        """Configure; nothing is trained.

        Args:
            make_head: Gives an untrained classifier.
            minibootstrap: Numbers of the Minibootstrap.
            shared: Train all classes on one pool instead of each on its own samples.
            repool: Look a second time at the refined boxes: scores are averaged and boxes refined again.
            vote_iou: Candidates of the same class that overlap a detection by more vote on its box; 1 for none.
        """
        self.make_head, self.minibootstrap = make_head, minibootstrap
        self.shared, self.repool, self.vote_iou = shared, repool, vote_iou
        self.normalization: Normalization | None = None
        self.heads: dict[int, OnlineHead] = {}  # by class; shared: the only one under 0
        self.additions: list[Addition] = []  # classes that came after the last whole training
        self.coarse, self.fine = BoxRegressors(), BoxRegressors()
        self._known = torch.zeros(0, dtype=torch.bool)  # (classes,): had a positive

    @property
    def number_of_classes(self) -> int:
        """Classes since the last training."""
        return len(self._known)

    def train(self, store: RegionStore, classes: int, generator: torch.Generator) -> None:
        """Train all classes anew on what the store holds.

        Args:
            store: Regions, labeled 0 to classes - 1.
            classes: Number of classes; those without a positive are never found.
            generator: Decides which negatives are seen.
        """
        normalization = Normalization.of_classes(store.features, store.label, generator)
        X = normalization.rows_of(store.features)
        budget = self.minibootstrap.budget
        heads: dict[int, OnlineHead] = {}
        if self.shared:
            label = self._limited(store, 0, classes, generator)
            heads[0] = self.minibootstrap.train_shared(
                self.make_head, X, label, shared_negatives(store, budget, generator), classes
            )
        else:
            for c in range(classes):
                positives = torch.nonzero(store.label == c).flatten()
                negatives = class_negatives(store, c, budget, generator)
                head = self.minibootstrap.train_class(self.make_head, X, positives, negatives)
                if head is not None:
                    heads[c] = head
        self.coarse.fit(X, store, 0.0)
        if self.repool:
            self.fine.fit(X, store, TIGHT_IOU)
        self.normalization, self.heads, self.additions = normalization, heads, []
        self._known = torch.isin(torch.arange(classes), store.label)

    def add_classes(self, store: RegionStore, classes: int, generator: torch.Generator) -> None:
        """Train only the classes that are new since the last training; see `incremental` for where old ones yield.

        The scale of features and the old classes' box regressors stay as they are.

        Args:
            store: Regions, labeled 0 to classes - 1.
            classes: Number of classes, new ones included.
            generator: Decides which negatives are seen.
        """
        if self.normalization is None:
            raise NotFittedError("the detector has no classes to add to: train it first")
        known, budget = self.number_of_classes, self.minibootstrap.budget
        X = self.normalization.rows_of(store.features)
        additions: list[Addition] = []
        if self.shared:
            label = self._limited(store, known, classes, generator)
            negatives = later_negatives(store, known, budget, generator)
            arguments = self.minibootstrap, self.make_head, X, label, negatives
            additions.append(add_together(known, classes - known, *arguments))
        else:
            for c in range(known, classes):
                negatives = class_negatives(store, c, budget, generator)
                addition = add_class(c, self.minibootstrap, self.make_head, X, store.label, negatives)
                additions += [] if addition is None else [addition]
        self.coarse.fit(X, store, 0.0, known)
        if self.repool:
            self.fine.fit(X, store, TIGHT_IOU, known)
        self.additions = [*self.additions, *additions]
        self._known = torch.cat([self._known, torch.isin(torch.arange(known, classes), store.label)])

    def _limited(self, store: RegionStore, first: int, classes: int, generator: torch.Generator) -> torch.Tensor:
        """Return labels (n,), -1 for classes below `first` and for positives beyond a class's share of the budget.

        So many classes or long showings do not outgrow the negatives.
        """
        rows = torch.nonzero(store.label >= first).flatten()
        most = max(MIN_POSITIVES, self.minibootstrap.budget // (classes - first))
        rows = sample_per_group(rows, store.label[rows], most, generator)
        label = torch.full_like(store.label, -1)
        label[rows] = store.label[rows]
        return label

    def scores(self, X: torch.Tensor) -> torch.Tensor:
        """Return scores (n, classes) of normalized features X (n, d)."""
        scores = X.new_full((len(X), self.number_of_classes), NEVER)
        for c, head in self.heads.items():
            values = head.decision_function(X)
            scores[:, c : c + values.shape[1]] = values
        for addition in self.additions:
            addition.apply(scores, X)
        return torch.where(self._known, scores, NEVER)

    def fresh(self) -> OnlineDetector:
        """Return an untrained detector of the same configuration."""
        return type(self)(
            self.make_head, self.minibootstrap, shared=self.shared, repool=self.repool, vote_iou=self.vote_iou
        )

    def detect(self, extractor: FeatureExtractor, image: ImageFeatures, min_score: float) -> Detections:
        """Find the taught objects among an image's proposals.

        Per class: refine boxes, drop those under `min_score`, suppress overlaps above 0.3, of which at most 20
        remain, and let what was suppressed vote on the box.
        """
        if self.normalization is None:
            raise NotFittedError("the detector was asked to look before it was trained")
        size, boxes = image.image_size, image.proposals.cpu()
        X = self.normalization(extractor.region_features(image, boxes).float().cpu())
        scores = self.scores(X)
        rows, labels = torch.nonzero(scores > min_score, as_tuple=True)
        found = Detections(self.coarse.refine(X[rows], boxes[rows], labels, size), labels, scores[rows, labels])
        found = voted(suppressed(found), found, self.vote_iou)
        if not self.repool or len(found) == 0:
            return found
        X = self.normalization(extractor.region_features(image, found.boxes).float().cpu())
        again = self.scores(X).gather(1, found.labels[:, None]).squeeze(1)
        refined = self.fine.refine(X, found.boxes, found.labels, size)
        return suppressed(Detections(refined, found.labels, 0.5 * (found.scores + again)))

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return every tensor that decides what is found, by dotted name."""
        if self.normalization is None:
            raise NotFittedError("the detector has nothing to save before it was trained")
        state = {
            "normalization.mean": self.normalization.mean,
            "normalization.mean_norm": torch.tensor(self.normalization.mean_norm, dtype=torch.float64),
            "known": self._known,
        }
        groups = (("head", self.heads), ("coarse", self.coarse.heads), ("fine", self.fine.heads))
        for name, heads in groups:
            for c, head in heads.items():
                state |= with_prefix(f"{name}.{c}", head.state_dict())
        for a in self.additions:
            state |= with_prefix(f"added.{a.number}", a.head.state_dict())
        return state

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Load what `state_dict` returned; CheckpointError, and nothing changes, for anything else."""
        try:
            mean_norm, known = float(state["normalization.mean_norm"]), state["known"].clone()
            normalization = Normalization(state["normalization.mean"].clone(), mean_norm)
        except (KeyError, RuntimeError) as error:
            raise CheckpointError(f"this is no detector's state: {error}") from error
        loaded: dict[str, dict[int, OnlineHead]] = {"head": {}, "coarse": {}, "fine": {}, "added": {}}
        for key in sorted({tuple(name.split(".")[:2]) for name in state if name.split(".")[0] in loaded}):
            name, number = key
            head = self.make_head() if name in ("head", "added") else Rls(penalty=BOX_PENALTY)
            head.load_state_dict(part(state, f"{name}.{number}"))
            loaded[name][int(number)] = head
        if self.shared and set(loaded["head"]) != {0}:
            raise CheckpointError("the detector's state has a classifier per class; expected one for all (mode=shared)")
        self.additions = [Addition(c, head) for c, head in sorted(loaded["added"].items())]
        self.normalization, self.heads = normalization, loaded["head"]
        self._known = known
        self.coarse.heads = {c: h for c, h in loaded["coarse"].items() if isinstance(h, Rls)}
        self.fine.heads = {c: h for c, h in loaded["fine"].items() if isinstance(h, Rls)}


def suppressed(found: Detections) -> Detections:
    """Keep what no better detection of the same class overlaps by more than 0.3; at most 20 of a class, best first."""
    kept = batched_nms(found.boxes, found.scores, found.labels, NMS_IOU)
    labels = found.labels[kept]
    better = (labels[:, None] == labels).tril(-1).sum(dim=1)  # of the same class, before each
    return found.take(kept[better < MAX_OF_A_CLASS])


def voted(kept: Detections, candidates: Detections, vote_iou: float = STANDARD.vote_iou) -> Detections:
    """Average each box with the candidates of its class whose IoU with it is above `vote_iou`; scores stay.

    Source: box voting, Gidaris and Komodakis, Object detection via a multi-region and semantic segmentation-aware CNN
    model, 2015, section 5; the weights are exponential here, since scores may be negative.
    """
    if len(kept) == 0:
        return kept
    has_vote = (iou(kept.boxes, candidates.boxes) > vote_iou) & (kept.labels[:, None] == candidates.labels)
    lead = candidates.scores - kept.scores[:, None]  # at most 0 for voters: the best of them was kept
    weight = torch.where(has_vote, (VOTE_SHARPNESS * lead).clamp(max=0).exp(), 0.0)
    total = weight.sum(dim=1, keepdim=True)
    boxes = torch.where(total > 0, weight @ candidates.boxes / total.clamp(min=1e-9), kept.boxes)
    return Detections(boxes, kept.labels, kept.scores)
