"""Ours Serial: region proposals are trained first, regions and pixels on what they then propose (thesis 11.6.2)."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from icub_core.errors import NotFittedError
from icub_core.interfaces.feature_extractor import FeatureExtractor
from icub_core.interfaces.online_head import OnlineHead
from icub_core.interfaces.segmenter import UpdateReport
from icub_segmenters.observations import Observations
from icub_segmenters.online_rpn import cells_of, with_proposals
from icub_segmenters.online_segmenter import OnlineSegmenter
from icub_segmenters.region_store import RegionStore
from icub_segmenters.training_image import TrainingImage


class Images(Observations):
    """Keeps images and the cells of the proposal network; regions are described when images are extracted again."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        """Start empty; see `Observations`."""
        super().__init__(*arguments, **settings)
        self.images: list[TrainingImage] = []

    def extract_again(self, generator: torch.Generator) -> None:
        """Replace the regions and pixels by those of all images with the present on-line proposals."""
        assert self.rpn is not None
        self.store = RegionStore(self.extractor.region_dim, self.seed)
        self.masks = self.masks.fresh()
        with torch.no_grad():
            for image in self.images:
                features = with_proposals(self.rpn, self.extractor, self.extractor.extract(image.rgb))
                self._keep_regions(features, image, generator)

    def _keep(self, training_image: TrainingImage, generator: torch.Generator) -> None:
        assert self.rpn is not None
        image = self.extractor.extract(training_image.rgb)
        self.rpn.observe(cells_of(self.extractor, image), training_image.boxes, image.image_size, generator)
        self.images.append(training_image)


class OursSerial(OnlineSegmenter):
    """Baseline: on-line region proposals are trained first, then all other heads on regions extracted again.

    While frames arrive only the cells of the proposal network are kept, with the images. `update` trains that
    network, goes through all images a second time with its proposals, and trains the other heads: better regions to
    learn from, at the price of a second extraction after the last frame. Images of earlier updates are gone through
    again, too, since the proposals have changed.

    Source: thesis 11.6.2, figure 11.5.
    """

    observations_type = Images

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
            batch_size: Negatives per batch (BS).
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

    def update(self) -> UpdateReport:
        """Train the proposals, extract the features of all images again, train the other heads.

        Raises:
            NotFittedError: No instance was ever observed.
        """
        seen = self.observations
        assert self.rpn is not None
        assert isinstance(seen, Images)
        if not any(len(image.numbers) for image in seen.images):
            raise NotFittedError("there is nothing to learn: observe at least one frame with an instance first")
        start = time.perf_counter()
        generator = seen.generator()
        self.rpn.train(generator)
        proposed = time.perf_counter()
        seen.extract_again(generator)
        extracted = time.perf_counter()
        parts = self._train_heads(generator)
        return self._report(start, {"rpn": proposed - start, "features": extracted - proposed, **parts})

    def add_classes(self) -> UpdateReport:
        """Train everything anew, as `update` does: new proposals change the regions of all classes."""
        return self.update()

    def load(self, path: Path) -> None:
        """Read what `save` wrote; images are not part of it, so that later updates learn from later frames alone."""
        super().load(path)
        assert isinstance(self.observations, Images)
        self.observations.images = []
