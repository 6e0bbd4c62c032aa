"""The on-line segmenter: taught by showing, trained in seconds (thesis chapters 10 and 11)."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import torch

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import CheckpointError, ConfigError, DataError, NotFittedError, unknown_name
from icub_core.interfaces.abilities import HasMaskBranch, ProposesCells, SharesKernel
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures
from icub_core.interfaces.online_head import OnlineHead
from icub_core.interfaces.segmenter import Segmenter, UpdateReport
from icub_segmenters.detection import Detections, OnlineDetector
from icub_segmenters.faithful_rpn import FaithfulRpn
from icub_segmenters.mask_geometry import boxes_of_masks, paste_masks
from icub_segmenters.masks import OnlineMasks
from icub_segmenters.minibootstrap import Minibootstrap
from icub_segmenters.observations import Observations
from icub_segmenters.online_rpn import OnlineRpn, with_proposals
from icub_segmenters.procedure import STANDARD, Procedure
from icub_segmenters.region_store import RegionStore
from icub_segmenters.shared_rpn import SharedRpn
from icub_support.weights import entry, part, read_tensors, with_prefix, write_tensors

MODES = ("shared", "faithful")
PROPOSALS = ("pretrained", "online")
MASKS = ("combined", "online", "pretrained")
FORMAT = 2
FILE = "segmenter.safetensors"
MIN_MASK = 20
"""Pixels; a smaller mask is not reported."""


class OnlineSegmenter(Segmenter):
    """On-line segmentation: pre-trained regions and features, classifiers for regions and pixels trained in seconds.

    While frames arrive (`observe`) features are computed and kept; `update` only trains heads: all classes of the
    detector anew on old and new regions together (Algorithms 2 and 3 keep the negatives balanced over images), masks
    of classes with new pixels only. A class of one single instance is learned from the boxes around it; a frame
    without instances adds negatives.

    An instance's score is that of the classifier; 0 is the decision threshold.

    Source: thesis 5.3, 10.3, 11.3, 11.8.1. Beyond it: classes share one pool of regions (mode ``"shared"``, see
    `Minibootstrap.train_shared`), taught objects are pasted into clutter, and regions are looked at twice.
    """

    detector_type: type[OnlineDetector] = OnlineDetector
    observations_type: type[Observations] = Observations

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
        procedure: Procedure = STANDARD,
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
            masks: ``"online"``: a classifier per class; ``"pretrained"``: the extractor's own class-agnostic masks;
                ``"combined"``: the mean of both where the extractor has a mask branch, else ``"online"``.
            repool: Look a second time at refined boxes.
            proposals: ``"pretrained"``: the extractor's own regions; ``"online"``: regions of a region proposal
                network trained here, on the cells that the extractor offers.
            seed: Decides everything random.
            procedure: Further numbers, which ablations change.
        """
        for what, value, known in (("mode", mode, MODES), ("kind of masks", masks, MASKS)):
            if value not in known:
                raise ConfigError(unknown_name(what, value, known))
        if proposals not in PROPOSALS:
            raise ConfigError(unknown_name("kind of proposals", proposals, PROPOSALS))
        if composites < 0:
            raise ConfigError(f"composites is {composites}; expected 0 or more")
        has_masks = isinstance(feature_extractor, HasMaskBranch)
        if masks == "pretrained" and not has_masks:
            raise ConfigError("masks='pretrained' needs a feature extractor with a mask branch; use masks='online'")
        if proposals == "online" and not isinstance(feature_extractor, ProposesCells):
            raise ConfigError("proposals='online' needs a feature extractor with a region proposal network")
        self.extractor = feature_extractor
        self.minibootstrap, self.procedure = Minibootstrap(batches, batch_size), procedure
        self.composites, self.seed = composites, seed
        self.asks_online, self.asks_pretrained = masks != "pretrained", masks != "online" and has_masks
        self.detector = self.detector_type(
            online_head, self.minibootstrap, shared=mode == "shared", repool=repool, vote_iou=procedure.vote_iou
        )
        rpn: OnlineRpn | None = None
        if proposals == "online":
            # a cell may be a positive of several anchor types and of some in part: that takes a regression
            shares = mode == "shared" and isinstance(online_head(), SharesKernel)
            rpn = (SharedRpn if shares else FaithfulRpn)(online_head, self.minibootstrap)
        self.observations = self.observations_type(
            feature_extractor,
            OnlineMasks(online_head, procedure.pixel_share),
            rpn,
            self.minibootstrap,
            procedure,
            seed,
            keep_pixels=self.asks_online,
        )
        self._trained: tuple[str, ...] = ()

    @property
    def classes(self) -> tuple[str, ...]:
        """Classes known since the last `update`, in the order in which they were first shown."""
        return self._trained

    @property
    def store(self) -> RegionStore:
        """Described regions of all frames."""
        return self.observations.store

    @property
    def masks(self) -> OnlineMasks:
        """Classifiers of pixels, and the pixels they learn from."""
        return self.observations.masks

    @property
    def rpn(self) -> OnlineRpn | None:
        """On-line region proposals; None where the extractor's own are used."""
        return self.observations.rpn

    def observe(self, frame: RgbdFrame, instances: Sequence[Instance]) -> None:
        """Extract the features of one annotated frame, and of `composites` images made of its instances.

        Raises:
            DataError: A mask is empty or has another size than the image; nothing is kept of the frame.
        """
        self.observations.observe(frame, instances, self.composites)

    def update(self) -> UpdateReport:
        """Train the heads on everything observed so far.

        Raises:
            NotFittedError: No instance was ever observed.
        """
        start = time.perf_counter()
        if not bool((self.store.label >= 0).any()):
            raise NotFittedError("there is nothing to learn: observe at least one frame with an instance first")
        # it depends on what was observed and on nothing else, so that updates in between change nothing
        generator = self.observations.generator()
        parts = self._train_heads(generator)
        if self.rpn is not None:
            with _timed(parts, "rpn"):
                self.rpn.train(generator)
        return self._report(start, parts)

    def add_classes(self) -> UpdateReport:
        """Train only the classes that were first shown since the last training; the others stay as they are.

        Old classes yield to the new one in regions that it claims with a higher score (see `incremental`). Unlike
        `update` the result depends on when it is called; a later `update` trains all anew. On-line region
        proposals, which all classes share, are trained anew.

        Raises:
            NotFittedError: Before the first `update`.
            DataError: No class was shown for the first time since the last training.
        """
        start = time.perf_counter()
        if not self._trained:
            raise NotFittedError("there are no classes to add to: call update first")
        first = len(self._trained)
        labels = self.observations.labels
        if len(labels) == first:
            raise DataError("no class was first shown since the last training; expected one, or use update")
        generator = self.observations.generator()
        parts: dict[str, float] = {}
        with _timed(parts, "detection"):
            self.detector.add_classes(self.store, len(labels), generator)
        if self.asks_online:
            with _timed(parts, "masks"):
                self.masks.train(self.seed, first)
        self._trained = tuple(labels)
        if self.rpn is not None:
            with _timed(parts, "rpn"):
                self.rpn.train(generator)
        return self._report(start, parts)

    def _train_heads(self, generator: torch.Generator) -> dict[str, float]:
        """Train detector and masks on what is kept; return the seconds of each."""
        parts: dict[str, float] = {}
        with _timed(parts, "detection"):
            self.detector.train(self.store, len(self.observations.labels), generator)
        if self.asks_online:
            with _timed(parts, "masks"):
                self.masks.train(self.seed)
        self._trained = tuple(self.observations.labels)
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
            image = self.extractor.extract(frame.rgb)
            if self.rpn is not None:
                image = with_proposals(self.rpn, self.extractor, image)
            found = self.detector.detect(self.extractor, image, self.procedure.min_score)
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
        tensors = with_prefix("detector", self.detector.state_dict()) | with_prefix("masks", self.masks.state_dict())
        tensors |= with_prefix("store", self.store.state_dict())
        if self.rpn is not None:
            tensors |= with_prefix("rpn", self.rpn.state_dict())
        about = {
            "format": FORMAT,
            "labels": self.observations.labels,
            "trained": len(self._trained),
            "observed": self.observations.frames,
            "region_dim": self.extractor.region_dim,
            "mask_dim": self.extractor.mask_dim,
        }
        # names and tensors in one file: they cannot be of two different savings
        write_tensors(path / FILE, tensors, {"about": json.dumps(about)})

    def load(self, path: Path) -> None:
        """Read what `save` wrote; CheckpointError for anything else, and the segmenter stays as it was."""
        tensors, header = read_tensors(path / FILE)
        try:
            about = entry(header, "about", path / FILE)
            labels, trained, observed = list(about["labels"]), int(about["trained"]), int(about["observed"])
            dims = about["format"], about["region_dim"], about["mask_dim"]
        except (ValueError, KeyError, TypeError) as error:
            raise CheckpointError(f"{path} holds no segmenter: {error}") from error
        expected = FORMAT, self.extractor.region_dim, self.extractor.mask_dim
        if dims != expected:
            raise CheckpointError(f"{path} has format, region and mask dimensions {dims}; expected {expected}")
        detector, masks = self.detector.fresh(), self.masks.fresh()
        store = RegionStore(self.extractor.region_dim, self.seed)
        detector.load_state_dict(part(tensors, "detector"))
        masks.load_state_dict(part(tensors, "masks"))
        store.load_state_dict(part(tensors, "store"))
        seen = self.observations
        if seen.rpn is not None:
            rpn = seen.rpn.fresh()
            rpn.load_state_dict(part(tensors, "rpn"))
            seen.rpn = rpn
        self.detector, seen.masks, seen.store = detector, masks, store
        seen.labels, seen.frames, self._trained = labels, observed, tuple(labels[:trained])

    def _mask_values(self, image: ImageFeatures, found: Detections) -> torch.Tensor:
        values = []
        if self.asks_online:
            values.append(self.masks.predict(self.extractor, image, found.boxes, found.labels))
        if self.asks_pretrained:
            assert isinstance(self.extractor, HasMaskBranch)
            values.append(self.extractor.mask_probabilities(image, found.boxes).float().cpu())
        return torch.stack(values).mean(dim=0)


@contextlib.contextmanager
def _timed(parts: dict[str, float], part: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    parts[part] = time.perf_counter() - start
