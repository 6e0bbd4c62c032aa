"""DINOv2 features for the on-line heads, with the regions that the compact network proposes.

The heads work on it as on Mask R-CNN. The weights are a file of the user.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch.nn import functional
from torchvision.ops import roi_align

from icub_core.errors import WeightsError
from icub_core.interfaces.feature_extractor import RpnCells
from icub_segmenters.feature_extractors.compact import CompactMaskRcnn
from icub_segmenters.feature_extractors.region_network import RegionExtractor, RegionNetwork, check_sizes
from icub_segmenters.feature_extractors.resnet import TORCHVISION, freeze, preprocess
from icub_segmenters.feature_extractors.vision_transformer import HEAD_DIM, PATCH, VisionTransformer
from icub_segmenters.feature_extractors.weights import read_any
from icub_support.weights import fill

GRID = 2  # a region is described by the mean features of its four quarters
MASK_SIDE = 14


@dataclass(frozen=True, eq=False)
class _Maps:
    patches: torch.Tensor  # (1, dim, h / 14, w / 14)
    proposer: Any
    factor: torch.Tensor  # (4,) from this network's pixels to the proposer's


class TransformerRegions(RegionNetwork):
    """Regions of patch features; proposals, masks and refinement are another network's."""

    mask_size = MASK_SIDE

    def __init__(self, model: VisionTransformer, proposer: RegionNetwork, image_size: tuple[int, int]) -> None:
        """Join a transformer and a proposer whose masks are 14 x 14."""
        self._model: Any = freeze(model)
        self._proposer = proposer
        self._image_size = image_size
        self.mask_dim, self.region_dim = model.dim, model.dim * GRID**2

    def working_size(self, height: int, width: int) -> tuple[int, int]:
        """The largest size of about the image's shape that fits and consists of whole patches."""
        scale = min(self._image_size[0] / height, self._image_size[1] / width)
        h, w = (max(3, round(side * scale / PATCH)) * PATCH for side in (height, width))
        return h, w

    def run(self, image: torch.Tensor) -> tuple[_Maps, torch.Tensor, torch.Tensor]:
        """Patch features of an image (3, h, w) 0..255, and the proposer's regions."""
        height, width = image.shape[1:]
        h, w = self._proposer.working_size(height, width)
        small = functional.interpolate(image[None], size=(h, w), mode="bilinear", antialias=True, align_corners=False)
        content, boxes, scores = self._proposer.run(small[0])
        factor = torch.tensor([w / width, h / height] * 2)
        patches = self._model(preprocess(image, TORCHVISION)[None])
        return _Maps(patches, content, factor), boxes / factor, scores

    def describe(self, maps: _Maps, boxes: torch.Tensor) -> torch.Tensor:
        """Mean patch features of the four quarters of each box (N, 4 dim)."""
        return roi_align(maps.patches, [boxes], GRID, 1 / PATCH, sampling_ratio=4, aligned=True).flatten(1)

    def mask_maps(self, maps: _Maps, boxes: torch.Tensor) -> torch.Tensor:
        """Interpolated patch features (N, dim, 14, 14)."""
        return roi_align(maps.patches, [boxes], MASK_SIDE, 1 / PATCH, sampling_ratio=1, aligned=True)

    def mask_probabilities(self, maps: _Maps, boxes: torch.Tensor) -> torch.Tensor:
        """The proposer's masks."""
        return self._proposer.mask_probabilities(maps.proposer, boxes * maps.factor)

    def refine(self, maps: _Maps, boxes: torch.Tensor) -> torch.Tensor:
        """The proposer's refinement."""
        return self._proposer.refine(maps.proposer, boxes * maps.factor) / maps.factor

    def cells(self, maps: _Maps) -> RpnCells:
        """The proposer's cells."""
        cells = self._proposer.cells(maps.proposer)
        return RpnCells(cells.features, cells.anchors / maps.factor, cells.types)


def load_transformer(path: Path) -> VisionTransformer:
    """Read a DINOv2 checkpoint of the torch hub layout (ViT-S, B or L, with or without registers).

    Raises:
        WeightsError: Missing, truncated, or of another architecture.
    """
    tensors = read_any(path)
    position = tensors.get("pos_embed")
    depths = [int(match[1]) for key in tensors if (match := re.match(r"blocks\.(\d+)\.", key))]
    if position is None or not depths or "patch_embed.proj.weight" not in tensors:
        raise WeightsError(f"{path} does not have the names of a DINOv2 torch hub checkpoint")
    if position.ndim != 3 or position.shape[2] % HEAD_DIM:
        raise WeightsError(f"{path}: 'pos_embed' has shape {tuple(position.shape)}, expected (1, N, a multiple of 64)")
    registers = tensors["register_tokens"].shape[1] if "register_tokens" in tensors else 0
    model = VisionTransformer(position.shape[2], max(depths) + 1, position.shape[1], registers)
    fill(model, tensors, str(path))
    return model


class DinoV2(RegionExtractor):
    """DINOv2 patch features on the compact network's proposals; 1536 features per region with ViT-S."""

    def __init__(
        self,
        weights: str = "dinov2_vits14_pretrain.pth",
        proposer: str = "compact",
        image_size: list[int] | None = None,
        proposals: int = 100,
    ) -> None:
        """Load both networks.

        Args:
            weights: Path of a DINOv2 checkpoint as torch hub has it.
            proposer: Weights of the compact network that proposes regions, masks and refinements.
            image_size: Height and width of the area into which images are scaled; None: 336 x 448.
            proposals: Regions kept per image.

        Raises:
            WeightsError: Missing, truncated or foreign weights.
            ConfigError: A number that makes no sense.
        """
        check_sizes(image_size, proposals)
        size = (336, 448) if image_size is None else (int(image_size[0]), int(image_size[1]))
        inner = CompactMaskRcnn(proposer, proposals=proposals, mask_size=MASK_SIDE)
        super().__init__(TransformerRegions(load_transformer(Path(weights)), inner.network, size))
