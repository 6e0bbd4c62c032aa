"""Faulty feature extractors, on-line heads and segmenters."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from icub_core.data import Instance
from icub_core.errors import CheckpointError
from icub_core.interfaces.feature_extractor import RpnCells
from icub_testing.tiny.perception import TinyFeatureExtractor, TinyHead, TinySegmenter

from ..kernel_head import KernelHead
from .base import breaks


@breaks("feature_extractor", "check_dimensions")
class NumpyDimensions(TinyFeatureExtractor):
    @property
    def mask_size(self):
        return np.int64(super().mask_size)


@breaks("feature_extractor", "check_proposals")
class WorstFirst(TinyFeatureExtractor):
    def extract(self, rgb):
        found = super().extract(rgb)
        return replace(found, proposals=found.proposals.flip(0), scores=found.scores.flip(0))


@breaks("feature_extractor", "check_image_size")
class WidthFirst(TinyFeatureExtractor):
    def extract(self, rgb):
        return replace(super().extract(rgb), image_size=rgb.shape[1::-1])


@breaks("feature_extractor", "check_region_features")
class DoublePrecision(TinyFeatureExtractor):
    def region_features(self, features, boxes):
        described = super().region_features(features, boxes)
        return described.double() if len(boxes) > 1 else described


@breaks("feature_extractor", "check_mask_features")
class ChannelsFirst(TinyFeatureExtractor):
    def mask_features(self, features, boxes):
        described = super().mask_features(features, boxes)
        return described.permute(0, 3, 1, 2) if len(boxes) else described


@breaks("feature_extractor", "check_no_boxes")
class NeedsBoxes(TinyFeatureExtractor):
    def region_features(self, features, boxes):
        return torch.stack(list(super().region_features(features, boxes)))


@breaks("feature_extractor", "check_boxes_apart")
class NormalizesOverTheBatch(TinyFeatureExtractor):
    def region_features(self, features, boxes):
        described = super().region_features(features, boxes)
        return described - described.mean(dim=0) if len(boxes) > 1 else described


@breaks("feature_extractor", "check_repeatable")
class DriftsWithUse(TinyFeatureExtractor):
    calls = 0

    def region_features(self, features, boxes):
        self.calls += 1
        return super().region_features(features, boxes) * (1 + 1e-6 * self.calls)


@breaks("feature_extractor", "check_inputs_unchanged")
class RoundsTheBoxes(TinyFeatureExtractor):
    def mask_features(self, features, boxes):
        boxes.mul_(1.01)
        return super().mask_features(features, boxes)


@breaks("feature_extractor", "check_tells_apart")
class SeesNothing(TinyFeatureExtractor):
    def region_features(self, features, boxes):
        return torch.zeros_like(super().region_features(features, boxes))


@breaks("online_head", "check_scores")
class DoubleScores(TinyHead):
    def decision_function(self, X):
        return super().decision_function(X).double()


@breaks("online_head", "check_learns")
class LearnsNothing(TinyHead):
    def decision_function(self, X):
        return 0 * super().decision_function(X)


@breaks("online_head", "check_unfitted")
class AnswersUnfitted(TinyHead):
    def decision_function(self, X):
        return torch.zeros((len(X), 1)) if self._weights is None else super().decision_function(X)


@breaks("online_head", "check_forgets")
class StartsWarm(TinyHead):
    def fit(self, X, Y, sample_weight=None):
        used = self._weights is not None
        super().fit(X, Y, sample_weight)
        self._weights = self._weights + float(used)


@breaks("online_head", "check_repeatable")
class StartsAtRandom(TinyHead):
    def fit(self, X, Y, sample_weight=None):
        super().fit(X, Y, sample_weight)
        self._weights = self._weights + 1e-4 * torch.rand_like(self._weights)


@breaks("online_head", "check_stateless_scores")
class NormalizesByWhatItSaw(TinyHead):
    largest = 0.0

    def decision_function(self, X):
        self.largest = max(self.largest, float(X.abs().max()))
        return super().decision_function(X) / self.largest


@breaks("online_head", "check_inputs_unchanged")
class SmoothsTargets(TinyHead):
    def fit(self, X, Y, sample_weight=None):
        Y.mul_(0.9)
        super().fit(X, Y, sample_weight)


@breaks("online_head", "check_not_finite")
class SwallowsNaN(TinyHead):
    def fit(self, X, Y, sample_weight=None):
        super().fit(torch.nan_to_num(X, posinf=0.0), Y, sample_weight)


@breaks("online_head", "check_state_round_trip")
class LosesItsScale(TinyHead):
    def load_state_dict(self, state):
        super().load_state_dict(state)
        self._weights = 2 * self._weights


@breaks("online_head", "check_bad_state")
class IgnoresForeignState(TinyHead):
    def load_state_dict(self, state):
        if "weights" in state:
            super().load_state_dict(state)


@breaks("segmenter", "check_untaught")
class SegmentsUntaught(TinySegmenter):
    def segment(self, frame):
        return super().segment(frame) if self._known else ()


@breaks("segmenter", "check_classes")
class KnowsTooEarly(TinySegmenter):
    @property
    def classes(self):
        return tuple(self._observed)


@breaks("segmenter", "check_finds")
class FindsATip(TinySegmenter):
    def segment(self, frame):
        found = []
        for instance in super().segment(frame):
            tip = instance.mask & (np.cumsum(instance.mask).reshape(instance.mask.shape) < 0.3 * instance.mask.sum())
            found.append(Instance.from_mask(instance.label, tip, instance.score))
        return tuple(found)


@breaks("segmenter", "check_labels")
class NamesTheBackground(TinySegmenter):
    def segment(self, frame):
        ground = Instance.from_mask("background", np.ones(frame.depth.shape, dtype=bool), score=-1.0)
        return (*super().segment(frame), ground)


@breaks("segmenter", "check_masks")
class FixedMaskSize(TinySegmenter):
    def segment(self, frame):
        found = super().segment(frame)
        return tuple(Instance(i.label, i.score, i.box, i.mask[:120, :160].copy()) for i in found)


@breaks("segmenter", "check_order")
class WorstInstanceFirst(TinySegmenter):
    def segment(self, frame):
        return super().segment(frame)[::-1]


@breaks("segmenter", "check_keeps_old_classes")
class ForgetsOldClasses(TinySegmenter):
    def update(self):
        report = super().update()
        self._observed.clear()
        return report


@breaks("segmenter", "check_negative_frames")
class NeedsInstances(TinySegmenter):
    def observe(self, frame, instances):
        np.stack([instance.mask for instance in instances])
        super().observe(frame, instances)


@breaks("segmenter", "check_repeatable")
class TrainsAtRandom(TinySegmenter):
    def update(self):
        report = super().update()
        self._known = {label: c + 1e-3 * np.random.default_rng().random(3) for label, c in self._known.items()}
        return report


@breaks("segmenter", "check_segment_changes_nothing")
class LearnsWhileLooking(TinySegmenter):
    def segment(self, frame):
        seen = self.__dict__.setdefault("seen", set())
        seen.add(float(frame.rgb.mean()))
        return tuple(replace(i, score=i.score + 1e-6 * len(seen)) for i in super().segment(frame))


@breaks("segmenter", "check_inputs_unchanged")
class DrawsIntoTheImage(TinySegmenter):
    def segment(self, frame):
        found = super().segment(frame)
        frame.rgb[:2] = 0
        return found


@breaks("segmenter", "check_save_and_load")
class LoadsInexactly(TinySegmenter):
    def load(self, path):
        super().load(path)
        self._known = {label: color + 0.02 for label, color in self._known.items()}


@breaks("segmenter", "check_no_pickle")
class SavesAPickle(TinySegmenter):
    def save(self, path):
        super().save(path)
        Path(path, "heads.bin").write_bytes(pickle.dumps(self._known))


@breaks("segmenter", "check_bad_file")
class ForgetsBeforeItReads(TinySegmenter):
    def load(self, path):
        try:
            super().load(path)
        except CheckpointError:
            self._known = {}
            raise


@breaks("feature_extractor", "check_refined_boxes")
class RefinesToSize(TinyFeatureExtractor):
    def refined_boxes(self, features, boxes):
        return torch.cat([boxes[:, :2], boxes[:, 2:] - 2 * boxes[:, :2]], dim=1)


@breaks("feature_extractor", "check_mask_probabilities")
class MasksAreScores(TinyFeatureExtractor):
    def mask_probabilities(self, features, boxes):
        return 4 * self.mask_features(features, boxes)[..., 0] - 2


@breaks("feature_extractor", "check_rpn_cells")
class CellsWithoutTheirAnchors(TinyFeatureExtractor):
    def rpn_cells(self, features):
        return RpnCells(torch.zeros((6, 8)), torch.zeros((5, 3, 4)), torch.zeros((5, 3), dtype=torch.int64))


@breaks("online_head", "check_score_meaning")
class CallsLogOddsEstimates(TinyHead):
    def decision_function(self, X):
        return 5 * super().decision_function(X)


@breaks("online_head", "check_shares_kernel")
class AdoptsHalf(KernelHead):
    def adopt(self, system):
        super().adopt(system)
        self._weights = self._weights / 2


@breaks("segmenter", "check_adds_classes")
class ReplacesOldClasses(TinySegmenter):
    def add_classes(self):
        old = set(self._known)
        report = self.update()
        self._known = {label: color for label, color in self._known.items() if label not in old}
        return replace(report, classes=self.classes)
