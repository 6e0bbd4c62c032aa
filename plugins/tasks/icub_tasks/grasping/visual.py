"""The visual part of the observation: an encoder's features of three images, stacked as in Flare."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import torch
from numpy.typing import NDArray

from icub_core.interfaces.feature_extractor import FeatureExtractor
from icub_support.flare import HISTORY, flare


class VisualEncoder(ABC):
    """Turns an image into one feature vector. Contract: deterministic; images of any size."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Length F of a feature vector."""

    @abstractmethod
    def encode(self, rgb: NDArray[np.uint8]) -> torch.Tensor:
        """Encode an image (H, W, 3) uint8: (F,) float32."""


class ImageEncoder(VisualEncoder):
    """Describes the whole image as one region of a feature extractor, scaled to entries near the size of 1."""

    def __init__(self, extractor: FeatureExtractor) -> None:
        """Encode with any feature extractor plugin."""
        self._extractor = extractor

    @property
    def size(self) -> int:
        """Length of the extractor's description of a region."""
        return self._extractor.region_dim

    def encode(self, rgb: NDArray[np.uint8]) -> torch.Tensor:
        """Encode an image (H, W, 3) uint8: (region_dim,) float32, of root mean square 1."""
        height, width = rgb.shape[:2]
        with torch.no_grad():
            image = self._extractor.extract(rgb)
            whole = torch.tensor([[0.0, 0.0, float(width), float(height)]])
            described = self._extractor.region_features(image, whole)[0].float().cpu()
        return described / described.square().mean().sqrt().clamp_min(1e-6)


class VisualStack:
    """Features of the last three images of every world. A first image fills the whole history.

    One feature vector is kept for a step; the stack is made when it is asked for, which is what lets a replay buffer
    keep F numbers per step instead of 10 F.
    """

    def __init__(self, encoder: VisualEncoder, worlds: int) -> None:
        self._encoder = encoder
        self._features = torch.zeros(worlds, HISTORY, encoder.size)

    @property
    def size(self) -> int:
        """Length of the stacked vector, 5 F."""
        return 5 * self._encoder.size

    def begin(self, world: int, rgb: NDArray[np.uint8]) -> None:
        """Start an episode of one world with its first image."""
        self._features[world] = self._encoder.encode(rgb)

    def push(self, world: int, rgb: NDArray[np.uint8]) -> None:
        """Add the newest image of one world."""
        self._features[world] = torch.cat([self._features[world, 1:], self._encoder.encode(rgb)[None]])

    def stacked(self) -> torch.Tensor:
        """Return the stacked features (N, 5 F)."""
        return flare(self._features)

    def state_dict(self) -> torch.Tensor:
        """Return a copy of the history."""
        return self._features.clone()

    def load_state_dict(self, features: torch.Tensor) -> None:
        """Restore what `state_dict` returned."""
        self._features.copy_(features)
