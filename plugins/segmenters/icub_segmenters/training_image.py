"""One annotated image as tensors, and checks of its masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import DataError


@dataclass(frozen=True, eq=False)
class TrainingImage:
    """One image to learn from.

    Attributes:
        rgb: (H, W, 3) uint8.
        masks: (n, H, W) bool, of the taught objects.
        boxes: (n, 4) their tight boxes.
        numbers: (n,) int64, their classes.
        distractors: (k, 4) boxes of objects that are known to be none of the taught ones.
    """

    rgb: np.ndarray
    masks: torch.Tensor
    boxes: torch.Tensor
    numbers: torch.Tensor
    distractors: torch.Tensor


def check_masks(frame: RgbdFrame, instances: Sequence[Instance]) -> None:
    """Raise DataError when a mask is empty or has another size than the image."""
    size = frame.rgb.shape[:2]
    for instance in instances:
        if instance.mask.shape != size:
            raise DataError(f"the mask of '{instance.label}' is {instance.mask.shape}; expected the image's {size}")
        if not instance.mask.any():
            raise DataError(f"the mask of '{instance.label}' is empty; expected at least one pixel")


def stacked(masks: Sequence[np.ndarray], rgb: np.ndarray) -> torch.Tensor:
    """Return masks (n, H, W) bool of an image, n may be 0."""
    stacked = torch.zeros(len(masks), *rgb.shape[:2], dtype=torch.bool)
    for target, mask in zip(stacked, masks, strict=True):
        target.copy_(torch.from_numpy(np.ascontiguousarray(mask)))
    return stacked
