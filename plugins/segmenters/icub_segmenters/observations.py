"""What an on-line segmenter keeps of the frames it was shown, from one extraction of features per image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import DataError
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures
from icub_segmenters.clutter import Compositor, Cutout
from icub_segmenters.mask_geometry import boxes_of_masks
from icub_segmenters.masks import OnlineMasks, pixel_features
from icub_segmenters.minibootstrap import Minibootstrap
from icub_segmenters.online_rpn import OnlineRpn, cells_of, some_anchors
from icub_segmenters.procedure import Procedure
from icub_segmenters.region_store import RegionStore
from icub_segmenters.regions import describe
from icub_segmenters.sampling import thin_out
from icub_segmenters.training_image import TrainingImage, check_masks, stacked

SURPLUS = 1.5
"""Negatives in the store may outgrow the budget by this factor before old images are thinned out."""
ANCHORS_DESCRIBED = 400
"""Anchors of an image from which further negatives are drawn, as many as from the pre-trained network's proposals,
where regions are proposed on-line: the detector has never seen most of what is proposed to it otherwise, and takes some
of it for objects. Without them mask mAP50 on the table-top task was 74, with them 77 (one run)."""


class Observations:
    """Regions, pixels and cells of all images, and the labels that were seen.

    Every frame with instances also gives images in which its instances, in turns, are pasted into clutter.

    Attributes:
        labels: Class names, numbered in the order in which they were first seen.
        frames: Number of frames observed.
        store: Described regions.
        masks: Keeps the pixels.
        rpn: Keeps the cells; None where the extractor's own proposals are used.
    """

    def __init__(
        self,
        extractor: FeatureExtractor,
        masks: OnlineMasks,
        rpn: OnlineRpn | None,
        minibootstrap: Minibootstrap,
        procedure: Procedure,
        seed: int,
        *,
        keep_pixels: bool,
    ) -> None:
        """Start empty.

        Args:
            extractor: Proposes and describes regions.
            masks: Is given the pixels of true boxes.
            rpn: Is given the cells of every image.
            minibootstrap: Its budget of negatives bounds the memory.
            procedure: How many regions and pixels are kept.
            seed: Decides everything random.
            keep_pixels: Whether pixels are kept at all.
        """
        self.extractor, self.masks, self.rpn = extractor, masks, rpn
        self.budget, self.procedure, self.seed = minibootstrap.budget, procedure, seed
        self.keep_pixels = keep_pixels
        self.store = RegionStore(extractor.region_dim, seed)
        self.labels: list[str] = []
        self.frames = 0
        self._compositor: Compositor | None = None

    def generator(self) -> torch.Generator:
        """Return a generator that depends on the seed and the number of frames alone."""
        return torch.Generator().manual_seed(self.seed * 1_000_003 + self.frames)

    def observe(self, frame: RgbdFrame, instances: Sequence[Instance], composites: int) -> None:
        """Keep one annotated frame, and so many images made of its instances.

        Raises:
            DataError: A mask is empty or has another size than the image; nothing is kept of the frame.
        """
        size = frame.rgb.shape[:2]
        check_masks(frame, instances)
        generator, rng = self.generator(), np.random.default_rng((self.seed, self.frames))
        self._add(frame.rgb, [(i.label, i.mask) for i in instances], generator)
        self.frames += 1
        if composites == 0 or not instances:
            return
        if self._compositor is None:
            self._compositor = Compositor.from_folder(look_alikes=self.procedure.look_alikes)
            for picture in self._compositor.images[: self.procedure.bank_images]:
                others = [picture.objects == k for k in np.unique(picture.objects[picture.objects > 0])]
                self._add(picture.rgb, (), generator, others)
        cutouts = [Cutout.of(instance.label, frame.rgb, instance.mask) for instance in instances]
        for number in rng.permutation(max(composites, len(cutouts)))[:composites]:  # all in turn, if few
            made = self._compositor.compose(cutouts[number % len(cutouts)], (size[0], size[1]), rng)
            self._add(made.rgb, list(made.instances), generator, made.distractors)
        for cutout in cutouts:
            self._compositor.remember(cutout, rng)

    def _add(
        self,
        rgb: np.ndarray,
        instances: Sequence[tuple[str, np.ndarray]],
        generator: torch.Generator,
        distractors: Sequence[np.ndarray] = (),
    ) -> None:
        """Keep one image with its (label, mask) pairs and masks of other objects; all of it or nothing."""
        known = list(self.labels)
        masks, others = stacked([mask for _, mask in instances], rgb), stacked(distractors, rgb)
        boxes = boxes_of_masks(masks, torch.zeros(len(masks), 4))
        other_boxes = boxes_of_masks(others, torch.zeros(len(others), 4))
        numbers = torch.tensor([self._number(label) for label, _ in instances], dtype=torch.int64)
        try:
            with torch.no_grad():
                self._keep(TrainingImage(rgb, masks, boxes, numbers, other_boxes), generator)
        except DataError:
            self.labels = known
            raise

    def _keep(self, training_image: TrainingImage, generator: torch.Generator) -> None:
        image = self.extractor.extract(training_image.rgb)
        if self.rpn is None:
            self._keep_regions(image, training_image, generator)
            return
        cells = cells_of(self.extractor, image)
        # what is proposed later does not look like the pre-trained network's proposals: anchors stand for it
        anchors = some_anchors(cells, ANCHORS_DESCRIBED, image.image_size, generator)
        self._keep_regions(image, training_image, generator, anchors)
        self.rpn.observe(cells, training_image.boxes, image.image_size, generator)

    def _keep_regions(
        self,
        image: ImageFeatures,
        training_image: TrainingImage,
        generator: torch.Generator,
        others: torch.Tensor | None = None,
    ) -> None:
        """Keep regions and pixels of an image; nothing, if any of their features is not finite."""
        regions = describe(
            self.extractor,
            image,
            training_image.boxes,
            training_image.numbers,
            generator,
            training_image.distractors,
            others,
            self.procedure,
        )
        learns_pixels = self.keep_pixels and len(training_image.boxes) > 0
        pixels = pixel_features(self.extractor, image, training_image.boxes) if learns_pixels else None
        self.store.append(regions)
        if pixels is not None:
            self.masks.observe(pixels, training_image.boxes, training_image.masks, training_image.numbers, generator)
        if int((self.store.near < 0).sum()) > SURPLUS * self.budget:
            thin_out(self.store, self.budget)

    def _number(self, label: str) -> int:
        if label not in self.labels:
            self.labels.append(label)
        return self.labels.index(label)
