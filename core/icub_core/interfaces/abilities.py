"""What a plugin may offer beyond its contract: protocols that are asked for with `isinstance`, and in no other way.

A plugin offers an ability by having its methods; there is nothing to register::

    if isinstance(extractor, HasMaskBranch):
        masks = extractor.mask_probabilities(features, boxes)
"""

from __future__ import annotations

from typing import Protocol, Self, runtime_checkable

import torch

from icub_core.interfaces.feature_extractor import ImageFeatures, RpnCells
from icub_core.interfaces.segmenter import UpdateReport


@runtime_checkable
class Closable(Protocol):
    """Any plugin that holds files, processes or an engine."""

    def close(self) -> None:
        """Free what is held; may be called twice."""


@runtime_checkable
class AddsClasses(Protocol):
    """A segmenter that trains new classes alone and leaves the old ones as they are."""

    def add_classes(self) -> UpdateReport:
        """Train the classes that were first shown since the last training.

        Raises:
            NotFittedError: Before the first `update`.
            DataError: No class was shown for the first time since the last training.
        """


@runtime_checkable
class ProposesCells(Protocol):
    """A feature extractor from which an on-line region proposal network can learn."""

    def rpn_cells(self, features: ImageFeatures) -> RpnCells:
        """Return the features and anchors of every feature-map location."""


@runtime_checkable
class HasMaskBranch(Protocol):
    """A feature extractor with a pre-trained, class-agnostic mask branch."""

    def mask_probabilities(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Return (N, mask_size, mask_size) probabilities that a pixel of a box (N, 4) belongs to the box's object."""


class KernelSystem(Protocol):
    """The linear system of a kernel head with fixed centers, to which samples can be added at any time."""

    def add(self, X: torch.Tensor, Y: torch.Tensor) -> None:
        """Add samples X (n, d) with targets Y (n, t)."""

    def rows(self, X: torch.Tensor) -> torch.Tensor:
        """Return the kernel rows (n, M) between samples X (n, d) and the centers."""

    def scores(self, K: torch.Tensor) -> torch.Tensor:
        """Return the scores (n, t) of samples with kernel rows K (n, M), from all samples added so far."""

    def add_rows(self, K: torch.Tensor, Y: torch.Tensor) -> None:
        """Add samples whose kernel rows K (n, M) are known; K may be overwritten."""


@runtime_checkable
class SharesKernel(Protocol):
    """An on-line head that regresses targets by a kernel on centers, and lets the caller add samples step by step.

    All problems share the centers and the kernel rows. `fit(X, Y)` gives the scores of these steps: take
    ``X[choose_centers(Y)]`` as centers, make a system, add all samples, adopt it. Targets may be any real numbers.
    """

    def choose_centers(self, Y: torch.Tensor) -> torch.Tensor:
        """Return distinct row numbers (M,) of the samples that become centers, for targets Y (n, t) of all samples."""

    def kernel_system(self, centers: torch.Tensor, problems: int) -> KernelSystem:
        """Return a system without samples, for centers (M, d) and `problems` targets."""

    def adopt(self, system: KernelSystem) -> None:
        """Become the fitted head whose scores are those of a system that `kernel_system` made."""

    def with_at_most(self, centers: int) -> Self:
        """Return an untrained head of the same configuration that chooses at most so many centers."""
