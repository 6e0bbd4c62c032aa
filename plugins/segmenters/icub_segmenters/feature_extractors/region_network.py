"""What all region-based extractors share: resizing of images and boxes, and the rules about inputs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from icub_core.errors import ConfigError, DataError
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures, RpnCells

BOXES_AT_ONCE = 256  # bounds the memory of the heads


class RegionNetwork(ABC):
    """A network on images of its own working size; boxes are in the pixels of that size."""

    region_dim: int
    mask_dim: int
    mask_size: int

    @abstractmethod
    def working_size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width to which an image of this size is resized."""

    @abstractmethod
    def run(self, image: torch.Tensor) -> tuple[Any, torch.Tensor, torch.Tensor]:
        """Map an image (3, h, w) float32 0..255 to its maps, proposals (P, 4) and scores (P,), best first."""

    @abstractmethod
    def describe(self, maps: Any, boxes: torch.Tensor) -> torch.Tensor:
        """Region features (N, region_dim)."""

    @abstractmethod
    def mask_maps(self, maps: Any, boxes: torch.Tensor) -> torch.Tensor:
        """Mask features (N, mask_dim, mask_size, mask_size)."""

    @abstractmethod
    def mask_probabilities(self, maps: Any, boxes: torch.Tensor) -> torch.Tensor:
        """Pre-trained masks (N, mask_size, mask_size), 0..1, of whatever object a box holds."""

    def refine(self, maps: Any, boxes: torch.Tensor) -> torch.Tensor:
        """Boxes (N, 4) after the pre-trained class-agnostic refinement; unchanged when there is none."""
        return boxes

    @abstractmethod
    def cells(self, maps: Any) -> RpnCells:
        """Features and anchors of every location, which an on-line RPN learns from."""


def check_sizes(image_size: list[int] | None, proposals: int) -> None:
    """Refuse sizes that make no sense."""
    if proposals < 1:
        raise ConfigError(f"proposals={proposals}; expected at least 1")
    if image_size is not None and (len(image_size) != 2 or min(image_size) < 32):
        raise ConfigError(f"image_size={list(image_size)}; expected height and width of at least 32 pixels")


@dataclass(frozen=True, eq=False)
class _Maps:
    """What is kept of an image: the network's maps and the factors (x, y, x, y) from image to working size."""

    content: Any
    factors: torch.Tensor
    size: tuple[int, int]


def as_rgb(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8 of a color image, a gray one (H, W) or (H, W, 1), or one with alpha (dropped).

    Raises:
        DataError: For any other shape or type, or an empty image.
    """
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
        raise DataError(f"an image of type {getattr(image, 'dtype', type(image).__name__)}; expected uint8 0..255")
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4) or 0 in image.shape:
        raise DataError(f"an image of shape {image.shape}; expected (H, W, 3), (H, W), (H, W, 1) or (H, W, 4)")
    return np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image[..., :3]


def _inside(boxes: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Clip boxes (N, 4) to an image, against rounding too."""
    return torch.minimum(boxes.clamp(min=0), torch.tensor([width, height] * 2, dtype=boxes.dtype))


class RegionExtractor(FeatureExtractor):
    """A feature extractor on a `RegionNetwork`."""

    def __init__(self, network: RegionNetwork) -> None:
        """Wrap a network."""
        self._network = network

    @property
    def network(self) -> RegionNetwork:
        """The network behind this extractor."""
        return self._network

    @property
    def region_dim(self) -> int:
        """Length of a region's feature vector."""
        return self._network.region_dim

    @property
    def mask_dim(self) -> int:
        """Length of a mask pixel's feature vector."""
        return self._network.mask_dim

    @property
    def mask_size(self) -> int:
        """Side of a region's grid of mask pixels."""
        return self._network.mask_size

    @torch.no_grad()
    def extract(self, rgb: NDArray[np.uint8]) -> ImageFeatures:
        """Run backbone and region proposals.

        Args:
            rgb: (H, W, 3) uint8 of any size; gray images are repeated, alpha is dropped.

        Raises:
            DataError: For another type or shape, or an empty image.
        """
        rgb = as_rgb(rgb)
        height, width = rgb.shape[:2]
        h, w = self._network.working_size(height, width)
        if (h, w) != (height, width):
            mode = cv2.INTER_AREA if h < height else cv2.INTER_LINEAR
            rgb = np.asarray(cv2.resize(np.ascontiguousarray(rgb), (w, h), interpolation=mode), np.uint8)
        image = torch.from_numpy(np.ascontiguousarray(rgb)).permute(2, 0, 1).float()
        content, boxes, scores = self._network.run(image)
        factors = torch.tensor([w / width, h / height] * 2)
        proposals = _inside(boxes / factors, height, width)
        return ImageFeatures(_Maps(content, factors, (h, w)), (height, width), proposals, scores)

    def scaled(self, features: ImageFeatures, boxes: torch.Tensor) -> tuple[Any, torch.Tensor]:
        """Boxes (N, 4) in working pixels, checked."""
        boxes = torch.as_tensor(boxes, dtype=torch.float32)
        if boxes.ndim != 2 or boxes.shape[1] != 4:
            raise DataError(f"boxes of shape {tuple(boxes.shape)}; expected (N, 4) x0 y0 x1 y1")
        if not torch.isfinite(boxes).all():
            raise DataError("boxes hold NaN or infinite values")
        maps: _Maps = features.maps
        return maps.content, boxes * maps.factors

    def _in_parts(
        self, method: Any, features: ImageFeatures, boxes: torch.Tensor, shape: tuple[int, ...]
    ) -> torch.Tensor:
        """Apply a head to boxes part by part; (0, *shape) for no boxes."""
        content, boxes = self.scaled(features, boxes)
        parts = [method(content, part) for part in boxes.split(BOXES_AT_ONCE) if len(part)]
        return torch.cat(parts) if parts else torch.zeros(0, *shape)

    @torch.no_grad()
    def region_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Describe boxes (N, 4), original pixels: (N, region_dim) float32."""
        return self._in_parts(self._network.describe, features, boxes, (self.region_dim,))

    @torch.no_grad()
    def mask_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Describe the pixels of boxes (N, 4): (N, mask_size, mask_size, mask_dim) float32."""
        shape = (self.mask_dim, self.mask_size, self.mask_size)
        out = self._in_parts(self._network.mask_maps, features, boxes, shape)
        return out.permute(0, 2, 3, 1).contiguous()

    @torch.no_grad()
    def mask_probabilities(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Pre-trained class-agnostic masks of boxes: (N, mask_size, mask_size) in 0..1."""
        shape = (self.mask_size, self.mask_size)
        return self._in_parts(self._network.mask_probabilities, features, boxes, shape)

    @torch.no_grad()
    def refined_boxes(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Boxes (N, 4), original pixels, after the pre-trained class-agnostic refinement, inside the image."""
        out = self._in_parts(self._network.refine, features, boxes, (4,)) / features.maps.factors
        return _inside(out, *features.image_size)

    @torch.no_grad()
    def rpn_cells(self, features: ImageFeatures) -> RpnCells:
        """Features and anchors of every location of the region proposal network, anchors in original pixels."""
        maps: _Maps = features.maps
        cells = self._network.cells(maps.content)
        return RpnCells(cells.features, cells.anchors / maps.factors, cells.types)
