"""How good pre-trained weights are on the FEATURE-TASK, and how well their proposals cover objects."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torchvision.ops import batched_nms

from icub_core.data import Instance
from icub_core.errors import ConfigError
from icub_core.interfaces.dataset import Dataset
from icub_core.interfaces.feature_extractor import FeatureExtractor
from icub_segmenters.feature_extractors.compact_regions import CompactRegions
from icub_segmenters.feature_extractors.proposals import average_recall, best_overlaps, recall
from icub_segmenters.feature_extractors.region_network import RegionExtractor
from icub_support.detection import evaluate_instances

SCORE_THRESHOLD, NMS_IOU, MAX_DETECTIONS = 0.05, 0.5, 50


def paste(mask: NDArray[np.float32], box: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Resize a mask (s, s) of probabilities to its box (4,) and paste it into an image of (H, W): (H, W) bool."""
    side = mask.shape[0]
    height, width = size
    x0, y0, x1, y1 = box
    # coordinates of the pixel centers in the grid of the mask, whose cells' centers are at 0.5, 1.5, ...
    xs = ((np.arange(width) + 0.5 - x0) / max(x1 - x0, 1e-3) * side - 0.5).astype(np.float32)
    ys = ((np.arange(height) + 0.5 - y0) / max(y1 - y0, 1e-3) * side - 0.5).astype(np.float32)
    left, right = int(max(np.floor(x0), 0)), int(min(np.ceil(x1), width))
    top, bottom = int(max(np.floor(y0), 0)), int(min(np.ceil(y1), height))
    out = np.zeros(size, dtype=np.bool_)
    if right > left and bottom > top:
        grid_x, grid_y = np.meshgrid(xs[left:right], ys[top:bottom])
        window = cv2.remap(mask, grid_x, grid_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        out[top:bottom, left:right] = window > 0.5
    return out


@torch.no_grad()
def detect(extractor: RegionExtractor, rgb: NDArray[np.uint8], classes: tuple[str, ...]) -> tuple[Instance, ...]:
    """Find the FEATURE-TASK's classes with the network's own classification layer."""
    regions = extractor.network
    if not isinstance(regions, CompactRegions):
        raise ConfigError(f"the network is {type(regions).__name__}; expected the compact one, which has such a layer")
    features = extractor.extract(rgb)
    content, boxes = extractor.scaled(features, features.proposals)
    scores = regions.class_scores(content, boxes)[:, 1:]
    refined = regions.refine(content, boxes)
    region, label = torch.nonzero(scores > SCORE_THRESHOLD, as_tuple=True)
    values = scores[region, label]
    kept = batched_nms(refined[region], values, label, NMS_IOU)[:MAX_DETECTIONS]
    region, label, values = region[kept], label[kept], values[kept]
    if not len(region):
        return ()
    masks = regions.mask_probabilities(content, refined[region]).numpy()
    originals = (refined[region] / features.maps.factors).double().numpy()
    return tuple(
        Instance(classes[int(c)], float(s), b, paste(m, b, features.image_size))
        for c, s, b, m in zip(label, values, originals, masks, strict=True)
    )


Progress = Callable[[float], None]


def proposal_recall(
    extractor: FeatureExtractor, data: Dataset, frames: int, progress: Progress = lambda share: None
) -> dict[str, float]:
    """Measure how well the proposals cover the objects of a data set, whatever their classes.

    Args:
        extractor: Any extractor.
        data: Annotated frames.
        frames: How many of them.
        progress: Called with the finished share.

    Returns:
        recall50_N and recall70_N of the first 20, 50 and 100 proposals, and average_recall_100.
    """
    truth, proposals = [], []
    for index, (frame, instances) in enumerate(islice(data, frames)):
        truth.append(np.array([i.box for i in instances], dtype=np.float64).reshape(-1, 4))
        proposals.append(extractor.extract(frame.rgb).proposals.double().numpy())
        progress((index + 1) / frames)
    figures: dict[str, float] = {}
    for top in (20, 50, 100):
        best = best_overlaps(truth, proposals, top)
        figures |= {f"recall50_{top}": recall(best, 0.5), f"recall70_{top}": recall(best, 0.7)}
    figures["average_recall_100"] = average_recall(best_overlaps(truth, proposals, 100))
    return figures


def feature_task_precision(
    extractor: RegionExtractor, data: Dataset, frames: int, progress: Progress = lambda share: None
) -> dict[str, float]:
    """Measure mAP on the FEATURE-TASK with the network's own classification layer.

    Args:
        extractor: With compact weights.
        data: Validation frames; the classes in the order of the labels.
        frames: How many of them; below 300 the mAP of 180 classes says little.
        progress: Called with the finished share.

    Returns:
        map50_bbox, map70_bbox, map50_segm, map70_segm, 0 to 1.
    """
    truth: list[tuple[Instance, ...]] = []
    found: list[tuple[Instance, ...]] = []
    for index, (frame, instances) in enumerate(islice(data, frames)):
        truth.append(instances)
        found.append(detect(extractor, frame.rgb, data.classes))
        progress((index + 1) / frames)
    return evaluate_instances(truth, found, data.classes).as_dict()
