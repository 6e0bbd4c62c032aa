"""Regions of an annotated image that the detector is trained on."""

from __future__ import annotations

import torch

from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures
from icub_segmenters.boxes import iou, jittered
from icub_segmenters.procedure import STANDARD, Procedure
from icub_segmenters.region_store import BACKGROUND, Regions
from icub_segmenters.sampling import sample

POSITIVE_IOU = 0.6
"""A region that overlaps a true box by at least this much is a positive of its class (thesis 11.3.2)."""
NEGATIVE_IOU = 0.3
"""A region that overlaps every true box by less is a negative (thesis 11.3.2)."""
KEPT_NEAR = 12
"""Regions an image contributes at most that overlap an object too little to be its positives and too much to be its
negatives; they are other classes' negatives."""
KEPT_NEGATIVES = 40
"""Negatives an image contributes at most before the budget is known; a uniform choice."""


def assign(
    boxes: torch.Tensor, truth: torch.Tensor, truth_label: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the class that each box belongs to.

    Args:
        boxes: (n, 4).
        truth: (m, 4) true boxes, m may be 0.
        truth_label: (m,) their classes.

    Returns:
        label (n,), near (n,) as in `Regions`, and the (n, 4) true box that each overlaps most.
    """
    if len(truth) == 0:
        nothing = torch.full((len(boxes),), BACKGROUND, dtype=torch.int64)
        return nothing, nothing.clone(), boxes.clone()
    overlap, best = iou(boxes, truth).max(dim=1)
    of_best = truth_label[best]
    label = torch.where(overlap >= POSITIVE_IOU, of_best, BACKGROUND)
    near = torch.where(overlap >= NEGATIVE_IOU, of_best, BACKGROUND)
    return label, near, truth[best]


def describe(
    extractor: FeatureExtractor,
    image: ImageFeatures,
    truth: torch.Tensor,
    truth_label: torch.Tensor,
    generator: torch.Generator,
    distractors: torch.Tensor | None = None,
    others: torch.Tensor | None = None,
    procedure: Procedure = STANDARD,
) -> Regions:
    """Describe true boxes (m, 4), boxes drawn around them, and the network's proposals (thesis 11.3.2).

    Boxes of other objects (k, 4), where they are known, are described too: what a distractor looks like when it is well
    framed is what must not be taken for a taught object, and few proposals of an image frame one.
    Of the proposals that are no positives a uniform choice is described; features of the others are not needed.
    Of other boxes (j, 4), where they are given, as many negatives are described as of the proposals.
    """
    around = [jittered(box, procedure.jittered_boxes, POSITIVE_IOU, image.image_size, generator) for box in truth]
    proposals = image.proposals.cpu()
    label, near, _ = assign(proposals, truth, truth_label)
    positive, between = label != BACKGROUND, (label == BACKGROUND) & (near != BACKGROUND)
    groups = ((positive, len(proposals)), (between, KEPT_NEAR), (near == BACKGROUND, KEPT_NEGATIVES))
    kept = torch.cat([sample(torch.nonzero(group).flatten(), most, generator) for group, most in groups])
    boxes_each = procedure.distractor_boxes
    for box in () if distractors is None or boxes_each == 0 else distractors:
        drawn = jittered(box, boxes_each - 1, POSITIVE_IOU, image.image_size, generator)
        around.append(torch.cat([box[None], drawn]))
    if others is not None:
        away = torch.nonzero(assign(others, truth, truth_label)[1] == BACKGROUND).flatten()
        around.append(others[sample(away, KEPT_NEGATIVES, generator)])
    boxes = torch.cat([truth, *around, proposals[kept]])
    label, near, targets = assign(boxes, truth, truth_label)
    features = extractor.region_features(image, boxes).float().cpu()
    return Regions(features, boxes, targets, label, near)
