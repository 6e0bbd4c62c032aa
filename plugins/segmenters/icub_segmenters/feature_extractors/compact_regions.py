"""Regions of the compact network: described, refined and masked by a trained `CompactNetwork`."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval
from torchvision.models.detection.image_list import ImageList
from torchvision.ops import clip_boxes_to_image, roi_align

from icub_core.errors import WeightsError
from icub_core.interfaces.feature_extractor import RpnCells
from icub_segmenters.feature_extractors.network import BOX_DIM, FPN_CHANNELS, LEVELS, MASK_DIM, WIDTHS, CompactNetwork
from icub_segmenters.feature_extractors.network import MASK_SIZE as NETWORK_MASK_SIZE
from icub_segmenters.feature_extractors.region_network import RegionNetwork
from icub_segmenters.feature_extractors.weights import read_safetensors
from icub_support.weights import fill

LOW_GRID, COLOR_GRID = 2, 4
# fc6, fc7, pooled FPN, pooled stride-4 map, pooled colors; blocks of equal norm
BLOCKS = (BOX_DIM, BOX_DIM, FPN_CHANNELS, WIDTHS[0] * LOW_GRID**2, 3 * COLOR_GRID**2)
CENTER, SCALE = "statistics.center", "statistics.scale"


@dataclass(frozen=True, eq=False)
class _CompactMaps:
    pyramid: dict[str, torch.Tensor]
    low: torch.Tensor  # (1, 32, h/4, w/4)
    colors: torch.Tensor  # (1, 3, h/4, w/4)
    size: tuple[int, int]


class CompactRegions(RegionNetwork):
    """Regions of the compact network: rich features, class-agnostic masks and refinement."""

    region_dim = sum(BLOCKS)
    mask_dim = MASK_DIM

    def __init__(
        self,
        network: CompactNetwork,
        center: torch.Tensor,
        scale: torch.Tensor,
        image_size: tuple[int, int] = (240, 320),
        mask_size: int = NETWORK_MASK_SIZE,
    ) -> None:
        """Prepare a trained network for use.

        Args:
            network: Trained; batch normalization is folded into the convolutions.
            center: (816,) mean of raw region features.
            scale: (816,) factor that brings every block to norm 1 on average.
            image_size: Height and width of the area into which images are scaled.
            mask_size: 28 as trained, or 14 (the average of 2 x 2 pixels).
        """
        self._network = fold_batch_norm(network.eval().requires_grad_(False))
        for part in (self._network.backbone, self._network.rpn):  # convolutions are a quarter faster this way
            part.to(memory_format=torch.channels_last)
        self._center, self._scale = center, scale
        self._image_size = image_size
        self.mask_size = mask_size
        self._last_masks: tuple[_CompactMaps, torch.Tensor, torch.Tensor] | None = None

    def working_size(self, height: int, width: int) -> tuple[int, int]:
        """The largest size of the image's shape that fits into the working area."""
        scale = min(self._image_size[0] / height, self._image_size[1] / width)
        return max(32, round(height * scale)), max(32, round(width * scale))

    def run(self, image: torch.Tensor) -> tuple[_CompactMaps, torch.Tensor, torch.Tensor]:
        """Backbone, RPN and low-level maps of an image (3, h, w) 0..255."""
        batch = image[None]
        pyramid, low, boxes, scores = self._network.propose(batch)
        colors = functional.avg_pool2d(batch / 255.0, 4, ceil_mode=True, count_include_pad=False)
        whole = {name: level.contiguous() for name, level in pyramid.items()}  # once, and not at every pooling
        maps = _CompactMaps(whole, low.contiguous(), colors, (image.shape[1], image.shape[2]))
        return maps, boxes, scores

    def _pooled(self, maps: _CompactMaps, boxes: torch.Tensor) -> torch.Tensor:
        return self._network.roi_heads.box_roi_pool(maps.pyramid, [boxes], [maps.size])

    def raw_features(self, maps: _CompactMaps, boxes: torch.Tensor) -> torch.Tensor:
        """The five blocks (N, 816) before centering and scaling."""
        pooled = self._pooled(maps, boxes)
        first, second = self._network.roi_heads.box_head.layers(pooled)
        low = roi_align(maps.low, [boxes], LOW_GRID, 0.25, sampling_ratio=4, aligned=True)
        colors = roi_align(maps.colors, [boxes], COLOR_GRID, 0.25, sampling_ratio=2, aligned=True)
        return torch.cat([first, second, pooled.mean((2, 3)), low.flatten(1), colors.flatten(1)], dim=1)

    def describe(self, maps: _CompactMaps, boxes: torch.Tensor) -> torch.Tensor:
        """Centered blocks (N, 816), each of average norm 1."""
        return (self.raw_features(maps, boxes) - self._center) * self._scale

    def _mask_features(self, maps: _CompactMaps, boxes: torch.Tensor) -> torch.Tensor:
        # pixel features and probabilities of the same boxes are asked for one after the other: computed once
        if self._last_masks is not None and self._last_masks[0] is maps and torch.equal(self._last_masks[1], boxes):
            return self._last_masks[2]
        heads = self._network.roi_heads
        out = heads.mask_head(heads.mask_roi_pool(maps.pyramid, [boxes], [maps.size]))
        self._last_masks = maps, boxes, out
        return out

    def mask_maps(self, maps: _CompactMaps, boxes: torch.Tensor) -> torch.Tensor:
        """The deconvolution's map (N, 64, mask_size, mask_size)."""
        out = self._mask_features(maps, boxes)
        return out if self.mask_size == NETWORK_MASK_SIZE else functional.avg_pool2d(out, 2)

    def mask_probabilities(self, maps: _CompactMaps, boxes: torch.Tensor) -> torch.Tensor:
        """Masks (N, mask_size, mask_size) of whatever object a box holds."""
        out = self._network.roi_heads.mask_predictor(self._mask_features(maps, boxes)).sigmoid()
        return out[:, 0] if self.mask_size == NETWORK_MASK_SIZE else functional.avg_pool2d(out, 2)[:, 0]

    def refine(self, maps: _CompactMaps, boxes: torch.Tensor) -> torch.Tensor:
        """Apply the class-agnostic box regression once."""
        heads = self._network.roi_heads
        deltas = heads.box_predictor.bbox_pred(heads.box_head(self._pooled(maps, boxes)))
        moved = heads.box_coder.decode(deltas, [boxes])[:, 0]
        return clip_boxes_to_image(moved, maps.size)

    def class_scores(self, maps: _CompactMaps, boxes: torch.Tensor) -> torch.Tensor:
        """Probabilities (N, C + 1) of the FEATURE-TASK's classes, background first."""
        heads = self._network.roi_heads
        scores, _ = heads.box_predictor(heads.box_head(self._pooled(maps, boxes)))
        return scores.softmax(1)

    def cells(self, maps: _CompactMaps) -> RpnCells:
        """RPN features (128) of all cells of three levels, with three anchors of two sizes each per cell."""
        levels = [maps.pyramid[name] for name in LEVELS]
        rpn = self._network.rpn
        blank = torch.zeros(1, 3, *maps.size)
        anchors = rpn.anchor_generator(ImageList(blank, [maps.size]), levels)[0]
        per_cell = rpn.anchor_generator.num_anchors_per_location()[0]
        features = [rpn.head.conv(level)[0].flatten(1).T for level in levels]
        types = [torch.arange(per_cell).repeat(len(f), 1) + i * per_cell for i, f in enumerate(features)]
        return RpnCells(torch.cat(features), anchors.view(-1, per_cell, 4), torch.cat(types))


def fold_batch_norm(network: CompactNetwork) -> CompactNetwork:
    """Replace every convolution followed by batch normalization by one convolution, in place."""
    for parent in list(network.modules()):
        for name, child in list(parent.named_children()):
            if isinstance(child, nn.Sequential) and len(child) == 2:
                conv, norm = child
                if isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                    setattr(parent, name, fuse_conv_bn_eval(conv, norm))
    return network


def load_compact(path: Path) -> tuple[CompactNetwork, torch.Tensor, torch.Tensor]:
    """Read a weight file: network (batch normalization not folded), center and scale of the region features.

    Raises:
        WeightsError: Missing, truncated, of another architecture, or with wrong shapes.
    """
    tensors, metadata = read_safetensors(path)
    if metadata.get("architecture") != "compact":
        found = metadata.get("architecture", "unnamed")
        raise WeightsError(f"{path} holds an architecture '{found}', expected 'compact'")
    center, scale = tensors.pop(CENTER, None), tensors.pop(SCALE, None)
    for name, value in ((CENTER, center), (SCALE, scale)):
        if value is None or value.shape != (sum(BLOCKS),):
            shape = "nothing" if value is None else tuple(value.shape)
            raise WeightsError(f"{path}: '{name}' is {shape}, expected ({sum(BLOCKS)},)")
    network = CompactNetwork(int(metadata.get("classes", 0)))
    fill(network, tensors, str(path))
    return network, center.float(), scale.float()  # type: ignore[union-attr]


def calibrate(network: CompactNetwork, images: list[torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    """Measure the center (816,) and scale (816,) of raw region features on the proposals of images.

    Args:
        network: Trained; not changed.
        images: Each (3, H, W) uint8.
    """
    regions = CompactRegions(copy.deepcopy(network), torch.zeros(sum(BLOCKS)), torch.ones(sum(BLOCKS)))
    rows = []
    with torch.no_grad():
        for image in images:
            maps, boxes, _ = regions.run(image.float())
            rows.append(regions.raw_features(maps, boxes))
    raw = torch.cat(rows)
    center = raw.mean(0)
    blocks = (raw - center).split(BLOCKS, dim=1)
    scale = [torch.full((b.shape[1],), 1.0 / float(b.norm(dim=1).mean().clamp(min=1e-6))) for b in blocks]
    return center, torch.cat(scale)
