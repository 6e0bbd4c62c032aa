"""Mask R-CNN whose output layers alone are fine-tuned by gradient descent (thesis 10.4, table 11.1 and appendix B)."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional
from torchvision.ops import batched_nms

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import CheckpointError, ConfigError, DataError, NotFittedError
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures
from icub_core.interfaces.segmenter import Segmenter, UpdateReport
from icub_segmenters.boxes import decode, encode
from icub_segmenters.frame_store import FrameStore
from icub_segmenters.mask_geometry import boxes_of_masks, crop_masks, paste_masks
from icub_segmenters.regions import assign
from icub_segmenters.sampling import sample
from icub_support.overlap import boxes_of
from icub_support.weights import entry, fill, read_tensors, write_tensors

FILE = "output_layers.safetensors"
REGIONS, POSITIVE_SHARE = 64, 0.25
"""Regions a step learns from, as in Mask R-CNN."""
MIN_SCORE, NMS_IOU, MAX_DETECTIONS = 0.05, 0.5, 100
MIN_MASK = 20


class _OutputLayers(nn.Module):
    """Class scores, one box refinement and one mask logit per class."""

    def __init__(self, region_dim: int, mask_dim: int, classes: int) -> None:
        super().__init__()
        self.scores = nn.Linear(region_dim, classes + 1)  # background first
        self.boxes = nn.Linear(region_dim, 4 * classes)
        self.masks = nn.Linear(mask_dim, classes)
        for layer in (self.scores, self.boxes, self.masks):
            nn.init.normal_(layer.weight, std=0.01)
            nn.init.zeros_(layer.bias)


class OutputLayers(Segmenter):
    """Baseline by back-propagation: Mask R-CNN of which the output layers alone are trained, everything else frozen.

    Frames are kept and visited again in every epoch, each a step of its own. Adam is used where the thesis uses SGD:
    it needs fewer epochs here and so makes the baseline stronger. With `store_features` the frozen part runs once a
    frame, while frames arrive (thesis table 11.9, "store features"); with one epoch and `shuffle` off this is learning
    from the stream as it comes.
    """

    def __init__(
        self,
        feature_extractor: FeatureExtractor,
        epochs: int = 8,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-4,
        store_features: bool = False,
        shuffle: bool = True,
        seed: int = 0,
    ) -> None:
        """Configure; nothing is computed.

        Args:
            feature_extractor: Proposes and describes regions; stays as it is.
            epochs: Passes over the frames (the thesis: 8 on YCB-Video, 6 on HO-3D).
            learning_rate: Of Adam, falling to 0 along a cosine.
            weight_decay: Decoupled.
            store_features: Compute features once and keep them.
            shuffle: Visit frames in random order.
            seed: Decides order, sampled regions and first weights.
        """
        if epochs < 1:
            raise ConfigError(f"epochs is {epochs}; expected at least 1")
        self.extractor = feature_extractor
        self.epochs, self.learning_rate, self.weight_decay = epochs, learning_rate, weight_decay
        self.store_features, self.shuffle, self.seed = store_features, shuffle, seed
        self._store = FrameStore()
        self._kept: list[ImageFeatures] = []
        self._trained: tuple[str, ...] = ()
        self._layers: _OutputLayers | None = None

    @property
    def classes(self) -> tuple[str, ...]:
        """Classes known since the last `update`."""
        return self._trained

    def observe(self, frame: RgbdFrame, instances: Sequence[Instance]) -> None:
        """Keep one annotated frame.

        Raises:
            DataError: A mask is empty or has another size than the image; nothing is kept of the frame.
        """
        self._store.add(frame, instances)
        if self.store_features:
            self._kept.append(self.extractor.extract(frame.rgb))

    def update(self) -> UpdateReport:
        """Train the output layers from the start on all frames kept.

        Raises:
            NotFittedError: No instance was ever observed.
            DataError: The features of a frame are not finite; it is dropped, and what was learned before stays.
        """
        counts = self._store.counts()
        start = time.perf_counter()
        generator = torch.Generator().manual_seed(self.seed)
        with torch.random.fork_rng(devices=[]), torch.enable_grad():
            torch.manual_seed(self.seed)
            layers = _OutputLayers(self.extractor.region_dim, self.extractor.mask_dim, len(counts))
            optimizer = torch.optim.AdamW(
                layers.parameters(), lr=self.learning_rate, weight_decay=self.weight_decay, fused=True
            )
            schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, self.epochs * len(self._store))
            for _ in range(self.epochs):
                order = torch.randperm(len(self._store), generator=generator).tolist()
                for number in order if self.shuffle else range(len(self._store)):
                    optimizer.zero_grad()
                    self._loss(layers, number, generator).backward()
                    optimizer.step()
                    schedule.step()
        self._layers, self._trained = layers.eval().requires_grad_(False), tuple(counts)
        seconds = time.perf_counter() - start
        return UpdateReport(seconds, {"output_layers": seconds}, self._trained, counts)

    def segment(self, frame: RgbdFrame) -> tuple[Instance, ...]:
        """Find the taught objects, best first; scores are probabilities."""
        if self._layers is None:
            raise NotFittedError("nothing was taught yet: call observe for every frame, then update")
        with torch.no_grad():
            image = self.extractor.extract(frame.rgb)
            X = self.extractor.region_features(image, image.proposals)
            scores = self._layers.scores(X).softmax(dim=1)[:, 1:]
            rows, labels = torch.nonzero(scores > MIN_SCORE, as_tuple=True)
            deltas = self._layers.boxes(X[rows]).view(len(rows), -1, 4)[torch.arange(len(rows)), labels]
            boxes, score = decode(image.proposals[rows], deltas, image.image_size), scores[rows, labels]
            kept = batched_nms(boxes, score, labels, NMS_IOU)[:MAX_DETECTIONS]
            boxes, labels, score = boxes[kept], labels[kept], score[kept]
            logits = self._layers.masks(self.extractor.mask_features(image, boxes))
            values = logits[torch.arange(len(boxes)), :, :, labels].sigmoid()
            masks = paste_masks(values, boxes, image.image_size)
            boxes = boxes_of_masks(masks, boxes)
        return tuple(
            Instance(self._trained[label], s, box.double().numpy(), mask.numpy())
            for label, s, box, mask in zip(labels.tolist(), score.tolist(), boxes, masks, strict=True)
            if int(mask.sum()) >= MIN_MASK
        )

    def save(self, path: Path) -> None:
        """Write the output layers to the folder `path`; the frames are not part of it."""
        if self._layers is None:
            raise NotFittedError("nothing was taught yet: there is nothing to save")
        write_tensors(path / FILE, self._layers.state_dict(), {"labels": json.dumps(self._trained)})

    def load(self, path: Path) -> None:
        """Read what `save` wrote; CheckpointError for anything else, and the segmenter stays as it was."""
        tensors, header = read_tensors(path / FILE)
        labels = list(entry(header, "labels", path / FILE))
        layers = _OutputLayers(self.extractor.region_dim, self.extractor.mask_dim, len(labels))
        fill(layers, tensors, str(path / FILE), CheckpointError)
        self._layers = layers.eval().requires_grad_(False)
        self._store, self._trained, self._kept = FrameStore(labels), tuple(labels), []

    def _loss(self, layers: _OutputLayers, number: int, generator: torch.Generator) -> torch.Tensor:
        """Classification, box and mask loss of one frame."""
        frame, instances = self._store.frames[number]
        image = self._kept[number] if self.store_features else self.extractor.extract(frame.rgb)
        truth = torch.from_numpy(boxes_of(instances)).float()
        numbers = torch.tensor([self._store.labels.index(i.label) for i in instances], dtype=torch.int64)
        boxes = torch.cat([truth, image.proposals])
        label, near, targets = assign(boxes, truth, numbers)
        positive = sample(torch.nonzero(label >= 0).flatten(), round(POSITIVE_SHARE * REGIONS), generator)
        negative = sample(torch.nonzero(near < 0).flatten(), REGIONS - len(positive), generator)
        chosen = torch.cat([positive, negative])
        X = self.extractor.region_features(image, boxes[chosen])
        if not bool(torch.isfinite(X).all()):
            self._forget(number)
            raise DataError(f"the features of frame {number} are not finite; it is left out")
        loss = functional.cross_entropy(layers.scores(X), label[chosen] + 1)
        if len(positive) == 0:
            return loss
        own = label[positive]
        rows = torch.arange(len(positive))
        deltas = layers.boxes(X[: len(positive)]).view(len(positive), -1, 4)[rows, own]
        loss = loss + functional.smooth_l1_loss(deltas, encode(boxes[positive], targets[positive]), beta=1 / 9)
        # the mask of the true box that each positive overlaps most
        best = torch.cdist(targets[positive], truth).argmin(dim=1)
        masks = torch.stack([torch.from_numpy(i.mask) for i in instances])[best]
        inside = crop_masks(masks, boxes[positive], self.extractor.mask_size).round()
        logits = layers.masks(self.extractor.mask_features(image, boxes[positive]))[rows, :, :, own]
        return loss + functional.binary_cross_entropy_with_logits(logits, inside)

    def _forget(self, number: int) -> None:
        self._store.forget(number)
        if self.store_features:
            del self._kept[number]
