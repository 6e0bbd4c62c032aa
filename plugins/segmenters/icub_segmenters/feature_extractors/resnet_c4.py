"""Mask R-CNN with ResNet-50-C4, the thesis's extractor: 1024 RPN, 2048 region and 256 mask features, 15 anchors.

Differences from the thesis, which used Caffe2's weights through another library: Detectron2's checkpoint of the same
network (``mask_rcnn_R_50_C4``), its pixel conventions (no "+1" widths, RoIAlign at pixel centers), its image mean.
Images are scaled to a shorter side of 600 pixels and 300 proposals are kept, as in the thesis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn
from torch.nn import functional
from torchvision.models.detection._utils import BoxCoder
from torchvision.ops import clip_boxes_to_image, nms, roi_align

from icub_core.errors import WeightsError
from icub_core.interfaces.feature_extractor import RpnCells
from icub_segmenters.feature_extractors.region_network import RegionExtractor, RegionNetwork, check_sizes
from icub_segmenters.feature_extractors.resnet import (
    DETECTRON,
    freeze,
    layout_of,
    preprocess,
    rename_trunk,
    resnet50,
    shorter_side_size,
    without_configuration,
)
from icub_segmenters.feature_extractors.weights import read_any
from icub_support.weights import fill

STRIDE = 16
ANCHOR_SIZES, ASPECT_RATIOS = (32, 64, 128, 256, 512), (0.5, 1.0, 2.0)
RPN_DIM, REGION_DIM, MASK_DIM, POOLED = 1024, 2048, 256, 14
BEFORE_NMS, NMS_IOU = 1000, 0.7
SHORTER, LONGEST = 600, 1333


class _C4(nn.Module):
    """Trunk to stride 16, RPN, and the fifth stage as the head of regions."""

    def __init__(self, classes: int) -> None:
        super().__init__()
        whole = resnet50(DETECTRON)
        self.res5 = whole.layer4
        whole.layer4 = nn.Identity()
        whole.fc = nn.Identity()
        self.body = whole
        count = len(ANCHOR_SIZES) * len(ASPECT_RATIOS)
        self.rpn_conv = nn.Conv2d(1024, RPN_DIM, 3, padding=1)
        self.objectness = nn.Conv2d(RPN_DIM, count, 1)
        self.deltas = nn.Conv2d(RPN_DIM, 4 * count, 1)
        self.cls_score = nn.Linear(REGION_DIM, classes + 1)
        self.bbox_pred = nn.Linear(REGION_DIM, 4 * classes)
        self.deconv = nn.ConvTranspose2d(REGION_DIM, MASK_DIM, 2, 2)
        self.mask_logits = nn.Conv2d(MASK_DIM, classes, 1)

    def trunk(self, image: torch.Tensor) -> torch.Tensor:
        """(1, 3, H, W) to (1, 1024, H / 16, W / 16)."""
        body = self.body
        x = body.maxpool(functional.relu(body.bn1(body.conv1(image))))
        return body.layer3(body.layer2(body.layer1(x)))


def from_detectron(tensors: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Translate Detectron2's ``mask_rcnn_R_50_C4`` tensors into this module's names.

    Raises:
        WeightsError: For a tensor that such a checkpoint does not have.
    """
    heads = {
        "proposal_generator.rpn_head.conv": "rpn_conv",
        "proposal_generator.rpn_head.objectness_logits": "objectness",
        "proposal_generator.rpn_head.anchor_deltas": "deltas",
        "roi_heads.box_predictor.cls_score": "cls_score",
        "roi_heads.box_predictor.bbox_pred": "bbox_pred",
        "roi_heads.mask_head.deconv": "deconv",
        "roi_heads.mask_head.predictor": "mask_logits",
    }
    out = {}
    for key, value in without_configuration(tensors).items():
        owner, _, leaf = key.rpartition(".")
        name = rename_trunk(key, "backbone.", "body.")
        if name is None and (head := rename_trunk(key, "roi_heads.", "")) is not None:
            name = head.replace("layer4.", "res5.")
        if name is None and owner in heads:
            name = f"{heads[owner]}.{leaf}"
        if name is None:
            raise WeightsError(f"'{key}' is no tensor of Detectron2's mask_rcnn_R_50_C4")
        out[name] = value
    return out


def cell_anchors() -> torch.Tensor:
    """The anchors (15, 4) of a cell around the origin: by size, then by ratio (height over width)."""
    rows = []
    for size in ANCHOR_SIZES:
        for ratio in ASPECT_RATIOS:
            width = (size**2 / ratio) ** 0.5
            height = ratio * width
            rows.append([-width / 2, -height / 2, width / 2, height / 2])
    return torch.tensor(rows)


@dataclass(frozen=True, eq=False)
class _C4Maps:
    features: torch.Tensor  # (1, 1024, h / 16, w / 16)
    rpn: torch.Tensor  # (1, 1024, h / 16, w / 16)
    size: tuple[int, int]


class C4Regions(RegionNetwork):
    """Regions of Mask R-CNN R-50-C4."""

    region_dim, mask_dim, mask_size = REGION_DIM, MASK_DIM, POOLED

    def __init__(self, model: _C4, shorter_side: int, proposals: int) -> None:
        """Use a model; see `load`."""
        self._model: Any = freeze(model)
        self._shorter, self._proposals = shorter_side, proposals
        self._coder = BoxCoder((1.0, 1.0, 1.0, 1.0))
        self._box_coder = BoxCoder((10.0, 10.0, 5.0, 5.0))
        self._anchors = cell_anchors()

    @classmethod
    def load(cls, path: Path, shorter_side: int = SHORTER, proposals: int = 300) -> C4Regions:
        """Read a checkpoint of Detectron2's layout.

        Raises:
            WeightsError: Missing, truncated, foreign or wrongly shaped.
        """
        tensors = read_any(path)
        if layout_of(tensors) != DETECTRON:
            raise WeightsError(f"{path} does not have the names of Detectron2's mask_rcnn_R_50_C4")
        translated = from_detectron(tensors)
        if "cls_score.weight" not in translated:
            raise WeightsError(f"{path} lacks 'roi_heads.box_predictor.cls_score.weight'")
        model = _C4(len(translated["cls_score.weight"]) - 1)
        fill(model, translated, str(path))
        return cls(model, shorter_side, proposals)

    def working_size(self, height: int, width: int) -> tuple[int, int]:
        """Shorter side as configured (600 in the thesis)."""
        return shorter_side_size(height, width, self._shorter, LONGEST)

    def _grid(self, maps: torch.Tensor) -> torch.Tensor:
        """Anchors (L, 15, 4) of all cells, row by row."""
        height, width = maps.shape[2:]
        y, x = torch.meshgrid(torch.arange(height) * STRIDE, torch.arange(width) * STRIDE, indexing="ij")
        shift = torch.stack([x, y, x, y], dim=-1).reshape(-1, 1, 4).float()
        return shift + self._anchors

    def run(self, image: torch.Tensor) -> tuple[_C4Maps, torch.Tensor, torch.Tensor]:
        """Trunk and RPN of an image (3, h, w) 0..255."""
        size = (image.shape[1], image.shape[2])
        features = self._model.trunk(preprocess(image, DETECTRON)[None])
        rpn = functional.relu(self._model.rpn_conv(features))
        logits = self._model.objectness(rpn)[0].permute(1, 2, 0).flatten()
        count = len(self._anchors)
        deltas = self._model.deltas(rpn)[0].view(count, 4, *rpn.shape[2:]).permute(2, 3, 0, 1).reshape(-1, 4)
        anchors = self._grid(rpn).view(-1, 4)
        best = logits.topk(min(BEFORE_NMS, len(logits))).indices
        boxes = clip_boxes_to_image(self._coder.decode(deltas[best], [anchors[best]])[:, 0], size)
        scores = logits[best]  # ordered before the sigmoid, which makes equal what is very sure
        solid = ((boxes[:, 2:] - boxes[:, :2]) > 0).all(1)
        boxes, scores = boxes[solid], scores[solid]
        kept = nms(boxes, scores, NMS_IOU)[: self._proposals]
        return _C4Maps(features, rpn, size), boxes[kept], scores[kept].sigmoid()

    def _head(self, maps: _C4Maps, boxes: torch.Tensor) -> torch.Tensor:
        """The fifth stage on pooled regions: (N, 2048, 7, 7)."""
        pooled = roi_align(maps.features, [boxes], POOLED, 1 / STRIDE, sampling_ratio=0, aligned=True)
        out: torch.Tensor = self._model.res5(pooled)
        return out

    def describe(self, maps: _C4Maps, boxes: torch.Tensor) -> torch.Tensor:
        """Average of the fifth stage (N, 2048)."""
        return self._head(maps, boxes).mean((2, 3))

    def mask_maps(self, maps: _C4Maps, boxes: torch.Tensor) -> torch.Tensor:
        """The deconvolution's map (N, 256, 14, 14)."""
        return functional.relu(self._model.deconv(self._head(maps, boxes)))

    def mask_probabilities(self, maps: _C4Maps, boxes: torch.Tensor) -> torch.Tensor:
        """Masks (N, 14, 14) of the most probable of COCO's classes."""
        head = self._head(maps, boxes)
        label = self._model.cls_score(head.mean((2, 3)))[:, :-1].argmax(1)  # the last is the background
        logits = self._model.mask_logits(functional.relu(self._model.deconv(head)))
        return logits[torch.arange(len(boxes)), label].sigmoid()

    def refine(self, maps: _C4Maps, boxes: torch.Tensor) -> torch.Tensor:
        """Apply the box regression of the most probable of COCO's classes."""
        features = self.describe(maps, boxes)
        label = self._model.cls_score(features)[:, :-1].argmax(1)
        deltas = self._model.bbox_pred(features).view(len(boxes), -1, 4)[torch.arange(len(boxes)), label]
        out: torch.Tensor = self._box_coder.decode(deltas, [boxes])[:, 0]
        return out

    def cells(self, maps: _C4Maps) -> RpnCells:
        """RPN features (1024) of all cells with their 15 anchors."""
        anchors = self._grid(maps.rpn)
        types = torch.arange(len(self._anchors)).repeat(len(anchors), 1)
        return RpnCells(maps.rpn[0].flatten(1).T.contiguous(), anchors, types)


class ResNet50C4(RegionExtractor):
    """Mask R-CNN R-50-C4, the thesis's feature extractor: 2048 features per region, 256 per mask pixel on 14 x 14."""

    def __init__(
        self, weights: str = "mask_rcnn_R_50_C4.pth", shorter_side: int = SHORTER, proposals: int = 300
    ) -> None:
        """Load the network.

        Args:
            weights: Path of a Detectron2 ``mask_rcnn_R_50_C4`` checkpoint (.pth, .pkl or .safetensors).
            shorter_side: Pixels to which the shorter side of images is scaled.
            proposals: Regions kept per image.

        Raises:
            WeightsError: Missing, truncated or foreign weights.
            ConfigError: A number that makes no sense.
        """
        check_sizes([shorter_side, shorter_side], proposals)
        super().__init__(C4Regions.load(Path(weights), shorter_side, proposals))
