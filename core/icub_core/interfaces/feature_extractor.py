"""Feature extractor: a pre-trained network that proposes regions and describes them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class ImageFeatures:
    """What is computed once per image.

    Attributes:
        maps: Feature maps that regions are pooled from, in the extractor's own form.
        image_size: Height, width of the original image, pixels.
        proposals: (P, 4) float32 class-agnostic boxes, x0 y0 x1 y1 in original pixels, best first.
        scores: (P,) float32 objectness.
    """

    maps: Any
    image_size: tuple[int, int]
    proposals: torch.Tensor
    scores: torch.Tensor


@dataclass(frozen=True, eq=False)
class RpnCells:
    """What an on-line region proposal network learns from: one row per feature-map location.

    Attributes:
        features: (L, f_r) float32.
        anchors: (L, A, 4) float32, the anchors centered on each location, x0 y0 x1 y1 in original pixels.
        types: (L, A) int64, which classifier an anchor belongs to (its size and ratio), from 0.
    """

    features: torch.Tensor
    anchors: torch.Tensor
    types: torch.Tensor


class FeatureExtractor(ABC):
    """Frozen features of images, of regions and of the pixels of regions.

    Contract: the same image gives the same numbers; nothing is trained by being used; dimensions are constant.

    A pre-trained mask branch and cells for an on-line region proposal network are optional abilities: see
    `icub_core.interfaces.abilities.HasMaskBranch` and `ProposesCells`.
    """

    @property
    @abstractmethod
    def region_dim(self) -> int:
        """Length of a region's feature vector (the thesis's f_d)."""

    @property
    @abstractmethod
    def mask_dim(self) -> int:
        """Length of a mask pixel's feature vector (f_s)."""

    @property
    @abstractmethod
    def mask_size(self) -> int:
        """Side of a region's grid of mask pixels (s)."""

    @abstractmethod
    def extract(self, rgb: NDArray[np.uint8]) -> ImageFeatures:
        """Run the backbone and the region proposals on an image (H, W, 3) uint8 of any size."""

    @abstractmethod
    def region_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Describe boxes (N, 4), original pixels: (N, region_dim) float32."""

    @abstractmethod
    def mask_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Describe the pixels of boxes (N, 4): (N, mask_size, mask_size, mask_dim) float32."""

    def refined_boxes(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Return boxes (N, 4), original pixels, after a pre-trained class-agnostic refinement, if there is one."""
        return boxes
