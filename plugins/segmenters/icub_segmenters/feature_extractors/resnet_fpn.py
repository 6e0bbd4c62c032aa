"""Mask R-CNN with ResNet-50-FPN, from torchvision's or Detectron2's COCO checkpoints."""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torchvision.models.detection import MaskRCNN
from torchvision.models.detection.backbone_utils import BackboneWithFPN
from torchvision.models.detection.image_list import ImageList
from torchvision.ops import roi_align
from torchvision.ops.feature_pyramid_network import LastLevelMaxPool

from icub_core.errors import WeightsError
from icub_core.interfaces.feature_extractor import RpnCells
from icub_segmenters.feature_extractors.region_network import RegionExtractor, RegionNetwork, check_sizes
from icub_segmenters.feature_extractors.resnet import (
    DETECTRON,
    background_first,
    freeze,
    layout_of,
    preprocess,
    rename_trunk,
    resnet50,
    shorter_side_size,
    with_background,
    without_configuration,
)
from icub_segmenters.feature_extractors.weights import read_any
from icub_support.weights import fill

TORCHVISION_FILE = "maskrcnn_resnet50_fpn_coco-bf2d0c1e.pth"
SHORTER, LONGEST = 800, 1333
CANONICAL_SIDE, CANONICAL_LEVEL = 224, 4  # Lin et al. 2017, equation 1
LEVELS = ("0", "1", "2", "3")  # strides 4 to 32
FPN_CHANNELS = 256


def find_torchvision_weights() -> Path:
    """Return torchvision's COCO file from torch hub's folder.

    Raises:
        WeightsError: When it is not there; nothing is downloaded.
    """
    path = Path(torch.hub.get_dir()) / "checkpoints" / TORCHVISION_FILE
    if not path.is_file():
        raise WeightsError(
            f"the COCO weights are not at hand: put {TORCHVISION_FILE} (from download.pytorch.org/models) into "
            f"{path.parent}, or name a file as weights=PATH, or use the shipped weights=compact"
        )
    return path


def _build(classes: int, layout: str) -> MaskRCNN:
    """Mask R-CNN of torchvision with random weights; `classes` with the background."""
    trunk = resnet50(layout)
    stages = {f"layer{i + 1}": str(i) for i in range(4)}
    backbone = BackboneWithFPN(trunk, stages, [256, 512, 1024, 2048], FPN_CHANNELS, extra_blocks=LastLevelMaxPool())
    return MaskRCNN(backbone, num_classes=classes)


def from_detectron(tensors: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Translate Detectron2's ``mask_rcnn_R_50_FPN`` tensors into torchvision's names and class order.

    Raises:
        WeightsError: For a tensor that such a checkpoint does not have.
    """
    heads = {
        "proposal_generator.rpn_head.conv": "rpn.head.conv.0.0",
        "proposal_generator.rpn_head.objectness_logits": "rpn.head.cls_logits",
        "proposal_generator.rpn_head.anchor_deltas": "rpn.head.bbox_pred",
        "roi_heads.box_head.fc1": "roi_heads.box_head.fc6",
        "roi_heads.box_head.fc2": "roi_heads.box_head.fc7",
        "roi_heads.box_predictor.cls_score": "roi_heads.box_predictor.cls_score",
        "roi_heads.box_predictor.bbox_pred": "roi_heads.box_predictor.bbox_pred",
        "roi_heads.mask_head.deconv": "roi_heads.mask_predictor.conv5_mask",
        "roi_heads.mask_head.predictor": "roi_heads.mask_predictor.mask_fcn_logits",
    }
    for i in range(4):
        heads[f"backbone.fpn_lateral{i + 2}"] = f"backbone.fpn.inner_blocks.{i}.0"
        heads[f"backbone.fpn_output{i + 2}"] = f"backbone.fpn.layer_blocks.{i}.0"
        heads[f"roi_heads.mask_head.mask_fcn{i + 1}"] = f"roi_heads.mask_head.{i}.0"
    out = {}
    for key, value in without_configuration(tensors).items():
        owner, _, leaf = key.rpartition(".")
        name = rename_trunk(key, "backbone.bottom_up.", "backbone.body.")
        if name is None and owner in heads:
            name = f"{heads[owner]}.{leaf}"
        if name is None:
            raise WeightsError(f"'{key}' is no tensor of Detectron2's mask_rcnn_R_50_FPN")
        if owner.endswith("cls_score"):
            value = background_first(value)
        elif owner.endswith("bbox_pred"):
            value = with_background(value, 4)
        elif owner.endswith("mask_head.predictor"):
            value = with_background(value, 1)
        out[name] = value
    return out


@dataclass(frozen=True, eq=False)
class _FpnMaps:
    pyramid: OrderedDict[str, torch.Tensor]
    size: tuple[int, int]


class FpnRegions(RegionNetwork):
    """Regions of Mask R-CNN R-50-FPN: 1024 features (fc7), 256 mask features on 28 x 28."""

    region_dim, mask_dim, mask_size = 1024, 256, 28

    def __init__(self, model: MaskRCNN, layout: str, image_size: tuple[int, int] | None, proposals: int) -> None:
        """Use a model; see `load`."""
        self._model: Any = freeze(model)
        self._layout, self._image_size = layout, image_size
        # Detectron2 samples at pixel centers; torchvision's weights were trained with the older convention
        self._aligned, self._samples = (True, 0) if layout == DETECTRON else (False, 2)
        model.rpn._post_nms_top_n["testing"] = proposals

    @classmethod
    def load(cls, path: Path, image_size: tuple[int, int] | None = None, proposals: int = 300) -> FpnRegions:
        """Read a checkpoint of torchvision's or Detectron2's layout.

        Args:
            path: File.
            image_size: Area into which images are scaled; None: shorter side 800, longer at most 1333.
            proposals: Regions kept per image.

        Raises:
            WeightsError: Missing, truncated, foreign or wrongly shaped.
        """
        tensors = read_any(path)
        layout = layout_of(tensors)
        if layout is None:
            raise WeightsError(f"{path} has neither torchvision's nor Detectron2's names of a Mask R-CNN")
        if layout == DETECTRON:
            tensors = from_detectron(tensors)
        scores = tensors.get("roi_heads.box_predictor.cls_score.weight")
        if scores is None:
            raise WeightsError(f"{path} lacks 'roi_heads.box_predictor.cls_score.weight': it is no Mask R-CNN")
        tensors = {_modern(key): value for key, value in tensors.items()}
        model = _build(len(scores), layout)
        fill(model, tensors, str(path))
        return cls(model, layout, image_size, proposals)

    def working_size(self, height: int, width: int) -> tuple[int, int]:
        """The size the weights were trained with, or the one that was asked for."""
        if self._image_size is None:
            return shorter_side_size(height, width, SHORTER, LONGEST)
        scale = min(self._image_size[0] / height, self._image_size[1] / width)
        return max(32, round(height * scale)), max(32, round(width * scale))

    def run(self, image: torch.Tensor) -> tuple[_FpnMaps, torch.Tensor, torch.Tensor]:
        """Backbone and RPN of an image (3, h, w) 0..255."""
        size = (image.shape[1], image.shape[2])
        pixels = preprocess(image, self._layout)
        # all levels of the pyramid need whole cells
        padded = torch.zeros(1, 3, -(-size[0] // 32) * 32, -(-size[1] // 32) * 32)
        padded[0, :, : size[0], : size[1]] = pixels
        pyramid = self._model.backbone(padded)
        boxes, scores = propose(self._model.rpn, padded, size, list(pyramid.values()))
        return _FpnMaps(pyramid, size), boxes, scores

    def _pool(self, maps: _FpnMaps, boxes: torch.Tensor, side: int) -> torch.Tensor:
        area = (boxes[:, 2:] - boxes[:, :2]).clamp(min=0).prod(1)
        level = torch.floor(CANONICAL_LEVEL + torch.log2(area.sqrt() / CANONICAL_SIDE + 1e-6)).clamp(2, 5) - 2
        out = torch.zeros(len(boxes), FPN_CHANNELS, side, side)
        for index, name in enumerate(LEVELS):
            chosen = torch.where(level == index)[0]
            if len(chosen):
                stride = 4.0 * 2**index
                out[chosen] = roi_align(
                    maps.pyramid[name], [boxes[chosen]], side, 1 / stride, self._samples, self._aligned
                )
        return out

    def describe(self, maps: _FpnMaps, boxes: torch.Tensor) -> torch.Tensor:
        """Activations of the second fully connected layer (N, 1024)."""
        out: torch.Tensor = self._model.roi_heads.box_head(self._pool(maps, boxes, 7))
        return out

    def mask_maps(self, maps: _FpnMaps, boxes: torch.Tensor) -> torch.Tensor:
        """The deconvolution's map (N, 256, 28, 28)."""
        heads = self._model.roi_heads
        deep = heads.mask_head(self._pool(maps, boxes, 14))
        out: torch.Tensor = heads.mask_predictor.relu(heads.mask_predictor.conv5_mask(deep))
        return out

    def _best_class(self, maps: _FpnMaps, boxes: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Most probable class but the background (N,) and the deltas of all (N, C, 4)."""
        scores, deltas = self._model.roi_heads.box_predictor(self.describe(maps, boxes))
        return scores[:, 1:].argmax(1) + 1, deltas.view(len(boxes), -1, 4)

    def mask_probabilities(self, maps: _FpnMaps, boxes: torch.Tensor) -> torch.Tensor:
        """Masks (N, 28, 28) of the most probable of COCO's classes."""
        label, _ = self._best_class(maps, boxes)
        logits = self._model.roi_heads.mask_predictor.mask_fcn_logits(self.mask_maps(maps, boxes))
        return logits[torch.arange(len(boxes)), label].sigmoid()

    def refine(self, maps: _FpnMaps, boxes: torch.Tensor) -> torch.Tensor:
        """Apply the box regression of the most probable of COCO's classes."""
        label, deltas = self._best_class(maps, boxes)
        chosen = deltas[torch.arange(len(boxes)), label]
        out: torch.Tensor = self._model.roi_heads.box_coder.decode(chosen, [boxes])[:, 0]
        return out

    def cells(self, maps: _FpnMaps) -> RpnCells:
        """RPN features (256) of five levels, three anchors of one size per cell."""
        rpn = self._model.rpn
        levels = list(maps.pyramid.values())
        blank = torch.zeros(1, 3, *(4 * s for s in levels[0].shape[2:]))
        anchors = rpn.anchor_generator(ImageList(blank, [maps.size]), levels)[0]
        features = [rpn.head.conv(level)[0].flatten(1).T for level in levels]
        types = [torch.arange(3).repeat(len(f), 1) + 3 * i for i, f in enumerate(features)]
        return RpnCells(torch.cat(features), anchors.view(-1, 3, 4), torch.cat(types))


def _modern(key: str) -> str:
    """Translate names of files from before torchvision 0.13: ``mask_fcn1`` and un-nested FPN and RPN convolutions."""
    key = re.sub(r"^rpn\.head\.conv\.(weight|bias)$", r"rpn.head.conv.0.0.\1", key)
    key = re.sub(r"^(backbone\.fpn\.(?:inner|layer)_blocks\.\d)\.(weight|bias)$", r"\1.0.\2", key)
    if match := re.fullmatch(r"roi_heads\.mask_head\.mask_fcn(\d)\.(weight|bias)", key):
        key = f"roi_heads.mask_head.{int(match[1]) - 1}.0.{match[2]}"
    return key


def propose(
    rpn: Any, images: torch.Tensor, size: tuple[int, int], levels: list[torch.Tensor]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Proposals (P, 4) and scores (P,) of one image by torchvision's RPN, which itself returns no scores."""
    objectness, deltas = rpn.head(levels)
    anchors = rpn.anchor_generator(ImageList(images, [size]), levels)
    counts = [o[0].numel() for o in objectness]
    logits = torch.cat([o.permute(0, 2, 3, 1).reshape(1, -1) for o in objectness], dim=1)
    flat = [d.view(1, -1, 4, *d.shape[2:]).permute(0, 3, 4, 1, 2).reshape(-1, 4) for d in deltas]
    boxes = rpn.box_coder.decode(torch.cat(flat), anchors).view(1, -1, 4)
    kept, scores = rpn.filter_proposals(boxes, logits.reshape(-1, 1), [size], counts)
    return kept[0], scores[0]


class ResNet50Fpn(RegionExtractor):
    """Mask R-CNN R-50-FPN: 1024 features per region, 256 per mask pixel on 28 x 28."""

    def __init__(self, weights: str = "coco", image_size: list[int] | None = None, proposals: int = 300) -> None:
        """Load the network.

        Args:
            weights: "coco": torchvision's file, when torch hub's folder has it; or the path of a checkpoint of
                torchvision's or Detectron2's layout.
            image_size: Height and width of the area into which images are scaled; None: shorter side 800 pixels.
            proposals: Regions kept per image.

        Raises:
            WeightsError: Missing, truncated or foreign weights.
            ConfigError: A number that makes no sense.
        """
        check_sizes(image_size, proposals)
        path = find_torchvision_weights() if weights == "coco" else Path(weights)
        size = None if image_size is None else (int(image_size[0]), int(image_size[1]))
        super().__init__(FpnRegions.load(path, size, proposals))
