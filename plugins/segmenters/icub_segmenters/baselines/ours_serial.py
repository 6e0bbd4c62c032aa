"""Ours Serial: region proposals are trained first, regions and pixels on what they then propose (thesis 11.6.2)."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import torch

from icub_core.errors import NotFittedError
from icub_core.interfaces.feature_extractor import FeatureExtractor
from icub_core.interfaces.online_head import OnlineHead
from icub_core.interfaces.segmenter import UpdateReport
from icub_segmenters.masks import OnlineMasks
from icub_segmenters.online_segmenter import OnlineSegmenter
from icub_segmenters.region_store import RegionStore
from icub_segmenters.training_image import TrainingImage


class OursSerial(OnlineSegmenter):
    """`OnlineSegmenter` with an on-line region proposal network and two extractions of features.

    While frames arrive only the cells of the proposal network are kept, with the images. `update` trains that
    network, goes through all images a second time with its proposals, and trains the other heads: better regions to
    learn from, at the price of a second extraction after the last frame. Images of earlier updates are gone through
    again, too, since the proposals have changed.

    Source: thesis 11.6.2, figure 11.5.
    """

    def __init__(
        self,
        feature_extractor: FeatureExtractor,
        online_head: Callable[[], OnlineHead],
        mode: str = "shared",
        batches: int = 10,
        batch_size: int = 2000,
        composites: int = 3,
        masks: str = "combined",
        seed: int = 0,
    ) -> None:
        """Configure; see `OnlineSegmenter`.

        Args:
            feature_extractor: Describes cells and regions; it must have a region proposal network.
            online_head: Gives an untrained classifier at every call.
            mode: ``"shared"`` or ``"faithful"``.
            batches: Batches of negatives (n_B).
            batch_size: Negatives in a batch (BS).
            composites: Images with pasted clutter made of every observed frame; 0 for none.
            masks: ``"online"``, ``"pretrained"`` or ``"combined"``.
            seed: Decides everything random.
        """
        super().__init__(
            feature_extractor,
            online_head,
            mode=mode,
            batches=batches,
            batch_size=batch_size,
            composites=composites,
            masks=masks,
            proposals="online",
            seed=seed,
        )
        self._training_images: list[TrainingImage] = []

    def update(self) -> UpdateReport:
        """Train the proposals, extract the features of all images again, train the other heads.

        Raises:
            NotFittedError: No instance was ever observed.
        """
        if not any(len(training_image.numbers) for training_image in self._training_images):
            raise NotFittedError("there is nothing to learn: observe at least one frame with an instance first")
        assert self.rpn is not None
        start = time.perf_counter()
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self._observed)
        self.rpn.train(generator)
        proposed = time.perf_counter()
        self.store = RegionStore(self.extractor.region_dim, self.seed)
        self.masks = OnlineMasks(self.masks.make_head)
        with torch.no_grad():
            for training_image in self._training_images:
                self._keep_regions(
                    self._proposed(self.extractor.extract(training_image.rgb)), training_image, generator
                )
        extracted = time.perf_counter()
        parts = self._train_heads(generator)
        return self._report(start, {"rpn": proposed - start, "features": extracted - proposed, **parts})

    def add_classes(self) -> UpdateReport:
        """Train everything anew, as `update` does: new proposals change the regions of all classes."""
        return self.update()

    def load(self, path: Path) -> None:
        """Read what `save` wrote; images are not part of it: what is observed later is learned anew, alone."""
        super().load(path)
        self._training_images = []

    def _take(self, training_image: TrainingImage, generator: torch.Generator) -> None:
        assert self.rpn is not None
        image = self.extractor.extract(training_image.rgb)
        self.rpn.observe(self._cells(image), training_image.boxes, image.image_size, generator)
        self._training_images.append(training_image)
