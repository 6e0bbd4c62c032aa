"""The on-line segmenter: taught by showing, trained in seconds (thesis chapters 10 and 11)."""

from __future__ import annotations

import contextlib
import json
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import CheckpointError, ConfigError, DataError, NotFittedError, unknown_name
from icub_core.files import write_atomically
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures, RpnCells
from icub_core.interfaces.online_head import OnlineHead
from icub_core.interfaces.segmenter import Segmenter, UpdateReport
from icub_segmenters.clutter import Compositor, Cutout
from icub_segmenters.detection import Detections, OnlineDetector
from icub_segmenters.faithful_rpn import FaithfulRpn
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.mask_geometry import boxes_of_masks, paste_masks
from icub_segmenters.masks import OnlineMasks, PretrainedMasks, pixel_features
from icub_segmenters.minibootstrap import Minibootstrap
from icub_segmenters.online_rpn import OnlineRpn, some_anchors
from icub_segmenters.region_store import RegionStore
from icub_segmenters.regions import describe
from icub_segmenters.sampling import thin_out
from icub_segmenters.shared_rpn import SharedRpn
from icub_segmenters.training_image import TrainingImage, check_masks, stacked

log = logging.getLogger(__name__)

MODES = ("shared", "faithful")
PROPOSALS = ("pretrained", "online")
MASKS = ("combined", "online", "pretrained")
FORMAT = 2
FILE = "segmenter.safetensors"
MIN_SCORE = -0.7
"""Instances that score less are not reported: between this and the targets of negatives, -1, all is noise."""
SURPLUS = 1.5
"""Negatives in the store may outgrow the budget by this factor before old images are thinned out."""
MIN_MASK = 20
"""Pixels; what is smaller than this is no finding."""
ANCHORS_DESCRIBED = 400
"""Anchors of a image from which further negatives are drawn, as many as from the pre-trained network's proposals,
where regions are proposed on-line: the detector has never seen most of what is proposed to it otherwise, and takes some
of it for objects. Without them mask mAP50 on the table-top task was 74, with them 77 (one run)."""
BANK_PICTURES = 0
"""Clutter images that are learned from as they are, before the first training image: a bank of negatives."""


class OnlineSegmenter(Segmenter):
    """Pre-trained regions and features, on-line classifiers for regions and for pixels.

    While frames arrive (`observe`) features are computed and kept; `update` only trains heads: all classes of the
    detector anew on old and new regions together (Algorithms 2 and 3 keep the negatives balanced over images), masks
    of classes with new pixels only. A class of one single instance is learned from the boxes around it; a frame
    without instances adds negatives.

    An instance's score is what the classifier says: targets were +1 and -1, so 0 is undecided.

    Source: thesis 5.3, 10.3, 11.3, 11.8.1. Beyond it: classes share one pool of regions (mode ``"shared"``, see
    `Minibootstrap.train_shared`), taught objects are pasted into clutter, and regions are looked at twice.
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
        repool: bool = False,
        proposals: str = "pretrained",
        seed: int = 0,
    ) -> None:
        """Configure; nothing is computed.

        Args:
            feature_extractor: Proposes and describes regions.
            online_head: Gives an untrained classifier at every call; used for regions and for pixels.
            mode: ``"shared"``: one pool and one factorization for all classes, and one for the anchor types of a
                level; ``"faithful"``: Algorithm 1, each class and anchor type with its own samples and centers.
            batches: Batches of negatives (n_B).
            batch_size: Negatives in a batch (BS).
            composites: Images with pasted clutter made of every observed frame, its instances taking turns; 0 for
                none.
            masks: ``"online"``: a classifier a class; ``"pretrained"``: the extractor's own class-agnostic masks;
                ``"combined"``: the mean of both where the extractor has a mask branch, else ``"online"``.
            repool: Look a second time at refined boxes.
            proposals: ``"pretrained"``: the extractor's own regions; ``"online"``: regions of a region proposal
                network trained here, on the cells that the extractor offers.
            seed: Decides everything random.
        """
        for what, value, known in (("mode", mode, MODES), ("kind of masks", masks, MASKS)):
            if value not in known:
                raise ConfigError(unknown_name(what, value, known))
        if proposals not in PROPOSALS:
            raise ConfigError(unknown_name("kind of proposals", proposals, PROPOSALS))
        if composites < 0:
            raise ConfigError(f"composites is {composites}; expected 0 or more")
        has_masks = isinstance(feature_extractor, PretrainedMasks)
        if masks == "pretrained" and not has_masks:
            raise ConfigError("masks='pretrained' needs a feature extractor with a mask branch; use masks='online'")
        self.extractor = feature_extractor
        self.procedure = Minibootstrap(batches, batch_size)
        self.composites, self.seed = composites, seed
        self.lowest_score = MIN_SCORE
        self.asks_online, self.asks_pretrained = masks != "pretrained", masks != "online" and has_masks
        self.detector = OnlineDetector(online_head, self.procedure, shared=mode == "shared", repool=repool)
        self.masks = OnlineMasks(online_head)
        self.rpn: OnlineRpn | None = None
        if proposals == "online":
            # a cell may be a positive of several anchor types, which a softmax, for one, cannot learn
            shares = mode == "shared" and isinstance(online_head(), Falkon)
            self.rpn = (SharedRpn if shares else FaithfulRpn)(online_head, self.procedure)
        self.store = RegionStore(feature_extractor.region_dim, seed)
        self._labels: list[str] = []  # numbered in the order in which they were first seen
        self._trained: tuple[str, ...] = ()
        self._observed = 0
        self._compositor: Compositor | None = None

    @property
    def classes(self) -> tuple[str, ...]:
        """Classes known since the last `update`, in the order in which they were first shown."""
        return self._trained

    def observe(self, frame: RgbdFrame, instances: Sequence[Instance]) -> None:
        """Extract the features of one annotated frame, and of `composites` images made of its instances.

        Raises:
            DataError: A mask is empty or has another size than the image; nothing is kept of the frame.
        """
        size = frame.rgb.shape[:2]
        check_masks(frame, instances)
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self._observed)
        rng = np.random.default_rng((self.seed, self._observed))
        self._learn_from(frame.rgb, [(i.label, i.mask) for i in instances], generator)
        self._observed += 1
        if self.composites == 0 or not instances:
            return
        if self._compositor is None:
            self._compositor = Compositor.from_folder()
            for picture in self._compositor.pictures[:BANK_PICTURES]:
                others = [picture.objects == k for k in np.unique(picture.objects[picture.objects > 0])]
                self._learn_from(picture.rgb, (), generator, others)
        cutouts = [Cutout.of(instance.label, frame.rgb, instance.mask) for instance in instances]
        for number in rng.permutation(max(self.composites, len(cutouts)))[: self.composites]:  # all in turn, if few
            made = self._compositor.compose(cutouts[number % len(cutouts)], (size[0], size[1]), rng)
            self._learn_from(made.rgb, list(made.instances), generator, made.distractors)
        for cutout in cutouts:
            self._compositor.remember(cutout, rng)

    def update(self) -> UpdateReport:
        """Train the heads on everything observed so far.

        Raises:
            NotFittedError: No instance was ever observed.
        """
        start = time.perf_counter()
        if not bool((self.store.label >= 0).any()):
            raise NotFittedError("there is nothing to learn: observe at least one frame with an instance first")
        # a function of what was observed and of nothing else, so that updates in between change nothing
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self._observed)
        parts = self._train_heads(generator)
        if self.rpn is not None:
            with _timed(parts, "rpn"):
                self.rpn.train(generator)
        return self._report(start, parts)

    def add_classes(self) -> UpdateReport:
        """Train only the classes that were first shown since the last training; the others stay as they are.

        In regions that the new class claims with more right the others yield (see `incremental`). Unlike `update` the
        result depends on when it is called; a later `update` trains all anew.
        On-line region proposals, which all classes share, are trained anew.

        Raises:
            NotFittedError: Before the first `update`.
            DataError: No class was shown for the first time since the last training.
        """
        start = time.perf_counter()
        if not self._trained:
            raise NotFittedError("there are no classes to add to: call update first")
        first = len(self._trained)
        if len(self._labels) == first:
            raise DataError("no class was first shown since the last training; expected one, or use update")
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self._observed)
        parts: dict[str, float] = {}
        with _timed(parts, "detection"):
            self.detector.add_classes(self.store, len(self._labels), generator)
        if self.asks_online:
            with _timed(parts, "masks"):
                self.masks.train(self.seed, first)
        self._trained = tuple(self._labels)
        if self.rpn is not None:
            with _timed(parts, "rpn"):
                self.rpn.train(generator)
        return self._report(start, parts)

    def _train_heads(self, generator: torch.Generator) -> dict[str, float]:
        """Train detector and masks on what is kept; return the seconds of each."""
        parts: dict[str, float] = {}
        with _timed(parts, "detection"):
            self.detector.train(self.store, len(self._labels), generator)
        if self.asks_online:
            with _timed(parts, "masks"):
                self.masks.train(self.seed)
        self._trained = tuple(self._labels)
        return parts

    def _report(self, start: float, parts: dict[str, float]) -> UpdateReport:
        counts = torch.bincount(self.store.label[self.store.label >= 0], minlength=len(self._trained)).tolist()
        return UpdateReport(
            seconds=time.perf_counter() - start,
            parts=parts,
            classes=self._trained,
            samples=dict(zip(self._trained, counts, strict=True)),
        )

    def segment(self, frame: RgbdFrame) -> tuple[Instance, ...]:
        """Find the taught objects, best first. Raises NotFittedError before the first `update`."""
        if not self._trained:
            raise NotFittedError("nothing was taught yet: call observe for every frame, then update")
        with torch.no_grad():
            image = self._proposed(self.extractor.extract(frame.rgb))
            found = self.detector.detect(self.extractor, image, self.lowest_score)
            masks = paste_masks(self._mask_values(image, found), found.boxes, image.image_size)
            large = torch.nonzero(masks.flatten(1).sum(dim=1) >= MIN_MASK).flatten()
            found, masks = found.take(large), masks[large]
            tight = Detections(boxes_of_masks(masks, found.boxes), found.labels, found.scores)
        return tuple(
            Instance(self._trained[label], score, box.double().numpy(), mask.numpy())
            for label, score, box, mask in zip(
                tight.labels.tolist(), tight.scores.tolist(), tight.boxes, masks, strict=True
            )
        )

    def save(self, path: Path) -> None:
        """Write heads and kept regions to the folder `path`, as segmenter.safetensors."""
        if not self._trained:
            raise NotFittedError("nothing was taught yet: there is nothing to save")
        tensors = {f"detector.{k}": v for k, v in self.detector.state_dict().items()}
        tensors |= {f"masks.{k}": v for k, v in self.masks.state_dict().items()}
        if self.rpn is not None:
            tensors |= {f"rpn.{k}": v for k, v in self.rpn.state_dict().items()}
        tensors |= {f"store.{k}": v for k, v in self.store.state_dict().items()}
        tensors = {name: tensor.contiguous() for name, tensor in tensors.items()}
        about = {
            "format": FORMAT,
            "labels": self._labels,
            "trained": len(self._trained),
            "observed": self._observed,
            "region_dim": self.extractor.region_dim,
            "mask_dim": self.extractor.mask_dim,
        }
        # names and tensors in one file: they cannot be of two different savings
        metadata = {"about": json.dumps(about)}
        write_atomically(path / FILE, lambda file: save_file(tensors, file, metadata))

    def load(self, path: Path) -> None:
        """Read what `save` wrote; CheckpointError for anything else, and the segmenter stays as it was."""
        try:
            with safe_open(path / FILE, framework="pt") as file:
                about = json.loads((file.metadata() or {})["about"])
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            labels, trained, observed = list(about["labels"]), int(about["trained"]), int(about["observed"])
            dims = about["format"], about["region_dim"], about["mask_dim"]
        except (OSError, ValueError, KeyError, TypeError, SafetensorError) as error:
            raise CheckpointError(f"{path} holds no segmenter: {error}") from error
        expected = FORMAT, self.extractor.region_dim, self.extractor.mask_dim
        if dims != expected:
            raise CheckpointError(f"{path} has format, region and mask dimensions {dims}; expected {expected}")
        parts = {
            part: {name[len(part) + 1 :]: t for name, t in tensors.items() if name.startswith(f"{part}.")}
            for part in ("detector", "masks", "store", "rpn")
        }
        detector = self.detector.fresh()
        masks, store = OnlineMasks(self.masks.make_head), RegionStore(self.extractor.region_dim, self.seed)
        detector.load_state_dict(parts["detector"])
        masks.load_state_dict(parts["masks"])
        store.load_state_dict(parts["store"])
        if self.rpn is not None:
            rpn = self.rpn.fresh()
            rpn.load_state_dict(parts["rpn"])
            self.rpn = rpn
        self.detector, self.masks, self.store = detector, masks, store
        self._labels, self._trained, self._observed = labels, tuple(labels[:trained]), observed

    def _learn_from(
        self,
        rgb: np.ndarray,
        instances: Sequence[tuple[str, np.ndarray]],
        generator: torch.Generator,
        distractors: Sequence[np.ndarray] = (),
    ) -> None:
        """Learn from one image with its (label, mask) pairs and masks of other objects; all of it or nothing."""
        known = list(self._labels)
        masks, others = stacked([mask for _, mask in instances], rgb), stacked(distractors, rgb)
        boxes = boxes_of_masks(masks, torch.zeros(len(masks), 4))
        other_boxes = boxes_of_masks(others, torch.zeros(len(others), 4))
        numbers = torch.tensor([self._number(label) for label, _ in instances], dtype=torch.int64)
        try:
            with torch.no_grad():
                self._take(TrainingImage(rgb, masks, boxes, numbers, other_boxes), generator)
        except DataError:
            self._labels = known
            raise

    def _take(self, training_image: TrainingImage, generator: torch.Generator) -> None:
        """Keep what a image teaches, from one extraction of features."""
        image = self.extractor.extract(training_image.rgb)
        if self.rpn is None:
            self._keep_regions(image, training_image, generator)
            return
        cells = self._cells(image)
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
        """Keep regions and pixels of a image; nothing, if any of their features is not finite."""
        regions = describe(
            self.extractor,
            image,
            training_image.boxes,
            training_image.numbers,
            generator,
            training_image.distractors,
            others,
        )
        learns_pixels = self.asks_online and len(training_image.boxes) > 0
        pixels = pixel_features(self.extractor, image, training_image.boxes) if learns_pixels else None
        self.store.append(regions)
        if pixels is not None:
            self.masks.observe(pixels, training_image.boxes, training_image.masks, training_image.numbers, generator)
        if int((self.store.near < 0).sum()) > SURPLUS * self.procedure.budget:
            thin_out(self.store, self.procedure.budget)

    def _proposed(self, image: ImageFeatures) -> ImageFeatures:
        """Replace the proposals of an image by those of the on-line network, if there is one."""
        if self.rpn is None:
            return image
        boxes, scores = self.rpn.propose(self._cells(image), image.image_size)
        return replace(image, proposals=boxes, scores=scores)

    def _cells(self, image: ImageFeatures) -> RpnCells:
        cells = self.extractor.rpn_cells(image)
        if cells is None:
            raise ConfigError("proposals='online' needs a feature extractor with a region proposal network")
        if not bool(torch.isfinite(cells.features).all()):
            raise DataError("the features of a image's cells are not finite; expected numbers")
        return cells

    def _mask_values(self, image: ImageFeatures, found: Detections) -> torch.Tensor:
        values = []
        if self.asks_online:
            values.append(self.masks.predict(self.extractor, image, found.boxes, found.labels))
        if self.asks_pretrained:
            assert isinstance(self.extractor, PretrainedMasks)
            values.append(self.extractor.mask_probabilities(image, found.boxes).float().cpu())
        return torch.stack(values).mean(dim=0)

    def _number(self, label: str) -> int:
        if label not in self._labels:
            self._labels.append(label)
        return self._labels.index(label)


@contextlib.contextmanager
def _timed(parts: dict[str, float], part: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    parts[part] = time.perf_counter() - start
