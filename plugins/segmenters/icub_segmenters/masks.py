"""On-line segmentation: which pixels of a region belong to the object (thesis 10.3.2, 11.3.3)."""

from __future__ import annotations

import torch
from torch.nn import functional

from icub_core.errors import CheckpointError, DataError, NotFittedError
from icub_core.interfaces.abilities import SharesKernel
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures
from icub_core.interfaces.online_head import OnlineHead, probabilities
from icub_segmenters.mask_geometry import crop_masks
from icub_segmenters.minibootstrap import MakeHead
from icub_segmenters.normalization import Normalization
from icub_segmenters.procedure import STANDARD
from icub_segmenters.sampling import sample
from icub_support.weights import part, with_prefix

MAX_PIXELS = 8_000
"""Pixels a class is trained on at most, half of them the object's; more add time but no accuracy."""
GRID = 14
"""Cells a side in which pixels are classified, the thesis's s; a finer grid of the extractor is averaged down to it.
A quarter of the work a frame; what the extractor's own masks show in finer detail is kept where both are combined."""
MAX_CENTERS = 200
"""Pixels of 64 features need fewer centers than regions: 1000 were measured to be no better, and much slower."""


class OnlineMasks:
    """One per-pixel classifier per class, on the pixels of true boxes.

    Positives of a class are its instances' pixels, negatives the other pixels of the same boxes; regions of other
    classes play no part, so a new class leaves the others' classifiers as they are (thesis 11.8.1).
    """

    def __init__(self, make_head: MakeHead, pixel_share: float = STANDARD.pixel_share) -> None:
        """Configure; `make_head` gives an untrained classifier; see `Procedure` for `pixel_share`."""
        self.make_head, self.pixel_share = make_head, pixel_share
        self.samples: dict[int, list[list[torch.Tensor]]] = {}  # class: [object's pixels, other pixels], (n, f) each
        self.heads: dict[int, OnlineHead] = {}
        self.scales: dict[int, Normalization] = {}
        self._stale: set[int] = set()

    def observe(
        self,
        features: torch.Tensor,
        boxes: torch.Tensor,
        masks: torch.Tensor,
        labels: torch.Tensor,
        generator: torch.Generator,
    ) -> None:
        """Keep a share of the pixels of true boxes.

        Args:
            features: (n, s, s, f) of the boxes' pixels, see `pixel_features`.
            boxes: (n, 4).
            masks: (n, H, W) bool.
            labels: (n,) classes.
            generator: Decides which pixels.
        """
        inside = crop_masks(masks, boxes, features.shape[1]) >= 0.5
        for pixels, of_object, label in zip(features, inside, labels.tolist(), strict=True):
            kinds = self.samples.setdefault(label, [[], []])
            for kind, chosen in zip(kinds, (of_object, ~of_object), strict=True):
                rows = torch.nonzero(chosen.flatten()).flatten()
                rows = sample(rows, int(self.pixel_share * len(rows)), generator)
                kind.append(pixels.flatten(0, 1)[rows])
                if sum(map(len, kind)) > 2 * MAX_PIXELS:  # memory stays bounded however long the showing
                    kind[:] = [_thinned(kind, MAX_PIXELS, generator)]
            self._stale.add(label)

    def train(self, seed: int, first: int = 0) -> None:
        """Train the classes that have new pixels; each class has its own scale, so the others do not change.

        Classes below `first` are not trained, new pixels or not.
        """
        ready = {label for label in self._stale if label >= first}
        for label in sorted(ready):
            generator = torch.Generator().manual_seed(seed * 1_000_003 + label)
            of_object, others = (_thinned(kind, MAX_PIXELS // 2, generator) for kind in self.samples[label])
            self.heads.pop(label, None)
            if len(of_object) == 0 or len(others) == 0:  # a mask that fills its box teaches nothing about edges
                continue
            X = torch.cat([of_object, others])
            Y = torch.cat([torch.ones(len(of_object), 1), -torch.ones(len(others), 1)])
            scale, head = Normalization.of(X), self.make_head()
            if isinstance(head, SharesKernel):
                head = head.with_at_most(MAX_CENTERS)
            head.fit(scale(X), Y)
            self.heads[label], self.scales[label] = head, scale
        self._stale -= ready

    def predict(
        self, extractor: FeatureExtractor, image: ImageFeatures, boxes: torch.Tensor, labels: torch.Tensor
    ) -> torch.Tensor:
        """Return (n, s, s) values in 0..1 for boxes (n, 4) of classes (n,): above 0.5 is the object.

        Only the classifier of a box's own class is asked (the released code asks all). A class without classifier
        fills its box.
        """
        if self._stale and not self.heads:
            raise NotFittedError("the mask classifiers were asked before they were trained")
        size = (extractor.mask_size, extractor.mask_size)
        if len(boxes) == 0:
            return torch.ones(0, *size)
        features = pixel_features(extractor, image, boxes)
        values = torch.ones(features.shape[:3])
        for label in labels.unique().tolist():
            head, rows = self.heads.get(label), torch.nonzero(labels == label).flatten()
            if head is not None:
                scores = head.decision_function(self.scales[label](features[rows].flatten(0, 2)))
                values[rows] = probabilities(scores, head.score).reshape(values[rows].shape).float()
        if values.shape[1:] == size:
            return values
        return functional.interpolate(values[:, None], size, mode="bilinear", align_corners=False)[:, 0]

    def fresh(self) -> OnlineMasks:
        """Return untrained classifiers of the same configuration, without pixels."""
        return type(self)(self.make_head, self.pixel_share)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return classifiers, scale and kept pixels, by dotted name."""
        state: dict[str, torch.Tensor] = {}
        for label, head in self.heads.items():
            state |= with_prefix(f"head.{label}", head.state_dict())
            state[f"mean.{label}"] = self.scales[label].mean
            state[f"mean_norm.{label}"] = torch.tensor(self.scales[label].mean_norm, dtype=torch.float64)
        for label, kinds in self.samples.items():
            state |= {f"pixels.{label}.{number}": torch.cat(kind) for number, kind in enumerate(kinds)}
        return state

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Load what `state_dict` returned; CheckpointError, and nothing changes, for anything else."""
        heads: dict[int, OnlineHead] = {}
        scales: dict[int, Normalization] = {}
        samples: dict[int, list[list[torch.Tensor]]] = {}
        try:
            for label in sorted({name.split(".")[1] for name in state if name.startswith("head.")}):
                heads[int(label)] = self.make_head()
                heads[int(label)].load_state_dict(part(state, f"head.{label}"))
                scales[int(label)] = Normalization(state[f"mean.{label}"].clone(), float(state[f"mean_norm.{label}"]))
            for label in sorted({name.split(".")[1] for name in state if name.startswith("pixels.")}):
                samples[int(label)] = [[state[f"pixels.{label}.{number}"].clone()] for number in range(2)]
        except (KeyError, ValueError, IndexError) as error:
            raise CheckpointError(f"this is no mask classifiers' state: {error}") from error
        self.heads, self.scales, self.samples = heads, scales, samples
        self._stale.clear()


def pixel_features(extractor: FeatureExtractor, image: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
    """Describe the cells of boxes (n, 4): (n, s, s, mask_dim) on the CPU, s at most GRID.

    Raises:
        DataError: The extractor's features are not finite.
    """
    features = extractor.mask_features(image, boxes).float().cpu()
    if not bool(torch.isfinite(features).all()):
        raise DataError("the features of an image's pixels are not finite; expected numbers")
    if extractor.mask_size <= GRID:
        return features
    return functional.adaptive_avg_pool2d(features.permute(0, 3, 1, 2), GRID).permute(0, 2, 3, 1).contiguous()


def _thinned(chunks: list[torch.Tensor], most: int, generator: torch.Generator) -> torch.Tensor:
    """Join chunks (., f) and keep a uniform choice of at most `most` rows."""
    rows = torch.cat(chunks)
    return rows if len(rows) <= most else rows[sample(torch.arange(len(rows)), most, generator)]
