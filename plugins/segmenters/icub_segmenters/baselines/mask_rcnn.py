"""Mask R-CNN (full): every layer of the compact network is fine-tuned on the taught frames (thesis 11.5)."""

from __future__ import annotations

import copy
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import nn

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import CheckpointError, ConfigError, NotFittedError, WeightsError
from icub_core.interfaces.segmenter import Segmenter, UpdateReport
from icub_segmenters.feature_extractors.compact_regions import (
    CENTER,
    SCALE,
    CompactRegions,
    calibrate,
    load_compact,
)
from icub_segmenters.feature_extractors.evaluation import detect
from icub_segmenters.feature_extractors.network import CompactNetwork
from icub_segmenters.feature_extractors.region_network import RegionExtractor
from icub_segmenters.feature_extractors.weights import weights_file
from icub_segmenters.frame_store import FrameStore
from icub_segmenters.mask_geometry import boxes_of_masks
from icub_support.weights import entry, read_tensors, write_tensors

FILE = "mask_rcnn.safetensors"
BATCH = 4
CLIP_NORM = 10.0
CALIBRATED = 20
"""Frames on whose proposals the scale of the new region features is measured."""


class MaskRcnn(Segmenter):
    """Upper bound by back-propagation: all of Mask R-CNN is fine-tuned, backbone, proposals and heads.

    It starts from the pre-trained compact network with a fresh classification layer; statistics of the batch
    normalization stay as they are, since small batches of one task would spoil them. Like the network itself it refines
    boxes and draws masks without regard to the class. With one epoch and `shuffle` off it learns from the stream as
    it comes (thesis tables 11.9 and 11.10).
    """

    def __init__(
        self,
        weights: str = "compact",
        epochs: int = 8,
        learning_rate: float = 5e-4,
        weight_decay: float = 1e-4,
        shuffle: bool = True,
        seed: int = 0,
    ) -> None:
        """Load the pre-trained network.

        Args:
            weights: ``"compact"`` (shipped) or the path of a file that ``icub train feature_extractor=compact`` wrote.
            epochs: Passes over the frames (the thesis: 3 on YCB-Video, 1 on HO-3D, with 70 times more frames).
            learning_rate: Of AdamW, falling to 0 along a cosine; new layers and old ones alike.
            weight_decay: Decoupled.
            shuffle: Visit frames in random order.
            seed: Decides order, sampled regions and first weights.

        Raises:
            WeightsError: Missing, truncated or foreign weights.
            ConfigError: A number of epochs that makes no sense.
        """
        if epochs < 1:
            raise ConfigError(f"epochs is {epochs}; expected at least 1")
        self._pretrained, *statistics = load_compact(weights_file(weights))
        self._statistics = statistics[0], statistics[1]  # center and scale of the region features
        self.epochs, self.learning_rate, self.weight_decay = epochs, learning_rate, weight_decay
        self.shuffle, self.seed = shuffle, seed
        self._store = FrameStore()
        self._trained: tuple[str, ...] = ()
        self._network: CompactNetwork | None = None
        self._extractor: RegionExtractor | None = None
        self._regions = CompactRegions(copy.deepcopy(self._pretrained), *self._statistics)

    @property
    def classes(self) -> tuple[str, ...]:
        """Classes known since the last `update`."""
        return self._trained

    def observe(self, frame: RgbdFrame, instances: Sequence[Instance]) -> None:
        """Keep one annotated frame; one without an instance is not trained on.

        Raises:
            DataError: A mask is empty or has another size than the image; nothing is kept of the frame.
        """
        self._store.add(frame, instances)

    def update(self) -> UpdateReport:
        """Fine-tune the pre-trained network, from the start, on all frames kept."""
        counts = self._store.counts()
        start = time.perf_counter()
        usable = [number for number, (_, instances) in enumerate(self._store.frames) if instances]
        generator = torch.Generator().manual_seed(self.seed)
        with torch.random.fork_rng(devices=[]), torch.enable_grad():
            torch.manual_seed(self.seed)
            network = self._fresh(len(counts))
            optimizer = torch.optim.AdamW(
                network.parameters(), lr=self.learning_rate, weight_decay=self.weight_decay, fused=True
            )
            steps = self.epochs * -(-len(usable) // BATCH)
            schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
            for _ in range(self.epochs):
                order = (
                    torch.randperm(len(usable), generator=generator).tolist() if self.shuffle else range(len(usable))
                )
                for batch in _batches([usable[i] for i in order]):
                    optimizer.zero_grad()
                    for images, targets in self._by_size(batch):
                        # a part's share of the batch, so that sizes do not change the step
                        share = len(images) / len(batch)
                        (share * torch.stack(list(network.losses(images, targets).values())).sum()).backward()
                    nn.utils.clip_grad_norm_(list(network.parameters()), CLIP_NORM)
                    optimizer.step()
                    schedule.step()
        network = network.eval().requires_grad_(False)
        seen = [self._example(*self._store.frames[number])[0] for number in usable[:: -(-len(usable) // CALIBRATED)]]
        self._adopt(network, tuple(counts), calibrate(network, seen))
        seconds = time.perf_counter() - start
        return UpdateReport(seconds, {"network": seconds}, self._trained, counts)

    def segment(self, frame: RgbdFrame) -> tuple[Instance, ...]:
        """Find the taught objects, best first; scores are probabilities."""
        if self._extractor is None:
            raise NotFittedError("nothing was taught yet: call observe for every frame, then update")
        found = detect(self._extractor, frame.rgb, self._trained)
        return tuple(instance for instance in found if instance.mask.any())

    def save(self, path: Path) -> None:
        """Write the whole network to the folder `path`, as mask_rcnn.safetensors; the frames are not part of it.

        The file can be given to ``feature_extractor=compact`` as ``weights``: features of the TARGET-TASK's own network
        (thesis table 10.2).
        """
        if self._network is None:
            raise NotFittedError("nothing was taught yet: there is nothing to save")
        tensors = self._network.state_dict() | {CENTER: self._statistics[0], SCALE: self._statistics[1]}
        classes = len(self._trained)
        header = {"labels": json.dumps(self._trained), "architecture": "compact", "classes": str(classes)}
        write_tensors(path / FILE, tensors, header)

    def load(self, path: Path) -> None:
        """Read what `save` wrote; CheckpointError for anything else, and the segmenter stays as it was."""
        labels = list(entry(read_tensors(path / FILE)[1], "labels", path / FILE))
        try:
            network, *statistics = load_compact(path / FILE)
        except WeightsError as error:
            raise CheckpointError(f"{path} holds no fine-tuned network: {error}") from error
        if network.classes != len(labels):
            raise CheckpointError(f"{path} has {len(labels)} labels for {network.classes} classes; expected as many")
        self._adopt(network, tuple(labels), (statistics[0], statistics[1]))
        self._store = FrameStore(labels)

    def _fresh(self, classes: int) -> CompactNetwork:
        """Return the pre-trained network with a new classification layer, ready to train."""
        network = CompactNetwork(classes)
        own = network.state_dict()
        old = self._pretrained.state_dict()
        network.load_state_dict({k: old[k] if old[k].shape == v.shape else v for k, v in own.items()})
        layer = network.roi_heads.box_predictor.cls_score
        nn.init.normal_(layer.weight, std=0.01)  # also where the numbers of classes happen to agree
        nn.init.zeros_(layer.bias)
        network = network.to(memory_format=torch.channels_last).train()
        for module in network.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
        return network

    def _by_size(self, batch: Sequence[int]) -> Iterator[tuple[torch.Tensor, list[dict[str, torch.Tensor]]]]:
        """Yield the frames of a batch at the network's working size, those of one size together."""
        sizes: dict[tuple[int, int], list[tuple[torch.Tensor, dict[str, torch.Tensor]]]] = {}
        for number in batch:
            image, target = self._example(*self._store.frames[number])
            sizes.setdefault((image.shape[1], image.shape[2]), []).append((image, target))
        for examples in sizes.values():
            yield torch.stack([image for image, _ in examples]), [target for _, target in examples]

    def _example(self, frame: RgbdFrame, instances: Sequence[Instance]) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Return the image (3, h, w) uint8 and the target of a frame, scaled as when it is asked."""
        height, width = self._regions.working_size(*frame.rgb.shape[:2])
        rgb, masks = frame.rgb, [i.mask.astype(np.uint8) for i in instances]
        if (height, width) != frame.rgb.shape[:2]:
            mode = cv2.INTER_AREA if height < frame.rgb.shape[0] else cv2.INTER_LINEAR
            rgb = np.asarray(cv2.resize(rgb, (width, height), interpolation=mode), np.uint8)
            masks = [cv2.resize(m, (width, height), interpolation=cv2.INTER_NEAREST).astype(np.uint8) for m in masks]
        stacked = torch.from_numpy(np.stack(masks))
        visible = stacked.flatten(1).bool().any(dim=1)  # a few pixels may vanish
        labels = torch.tensor([self._store.labels.index(i.label) + 1 for i in instances])
        boxes = boxes_of_masks(stacked.bool(), torch.zeros(len(stacked), 4))
        target = {"boxes": boxes[visible], "labels": labels[visible], "masks": stacked[visible]}
        return torch.from_numpy(np.array(rgb)).permute(2, 0, 1), target

    def _adopt(
        self, network: CompactNetwork, labels: tuple[str, ...], statistics: tuple[torch.Tensor, torch.Tensor]
    ) -> None:
        self._network, self._statistics = network.eval().requires_grad_(False), statistics
        # folding changes the network that is used, so it gets a copy
        self._extractor = RegionExtractor(CompactRegions(copy.deepcopy(self._network), *statistics))
        self._trained = labels


def _batches(numbers: Sequence[int]) -> Iterator[Sequence[int]]:
    for start in range(0, len(numbers), BATCH):
        yield numbers[start : start + BATCH]
