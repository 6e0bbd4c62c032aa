"""Conversion between masks of images and the square grids in which the pixels of a region are classified."""

from __future__ import annotations

import math

import torch
from torch.nn import functional

from icub_core.data import tight_boxes


def crop_masks(masks: torch.Tensor, boxes: torch.Tensor, side: int) -> torch.Tensor:
    """Sample masks (n, H, W) at the cell centers of a side x side grid on each box (n, 4): (n, side, side) in 0..1."""
    n, height, width = masks.shape
    steps = (torch.arange(side, dtype=torch.float32) + 0.5) / side
    x = boxes[:, None, 0] + steps * (boxes[:, None, 2] - boxes[:, None, 0])  # (n, side)
    y = boxes[:, None, 1] + steps * (boxes[:, None, 3] - boxes[:, None, 1])
    grid = torch.stack(
        [(2 * x / width - 1)[:, None, :].expand(n, side, side), (2 * y / height - 1)[:, :, None].expand(n, side, side)],
        dim=3,
    )
    return functional.grid_sample(masks[:, None].float(), grid, align_corners=False)[:, 0]


def paste_masks(values: torch.Tensor, boxes: torch.Tensor, image_size: tuple[int, int]) -> torch.Tensor:
    """Draw grids of values (n, s, s) into their boxes (n, 4): (n, H, W) bool, true above 0.5.

    Every pixel whose center lies in the box is interpolated bilinearly between cell centers. Boxes are not rounded, so
    masks are not shifted by half a pixel as with the integer boxes of the released code.
    """
    height, width = image_size
    pasted = torch.zeros(len(values), height, width, dtype=torch.bool)
    for value, box, target in zip(values, boxes.tolist(), pasted, strict=True):
        x0, y0, x1, y1 = box
        left, right = max(0, math.ceil(x0 - 0.5)), min(width, math.ceil(x1 - 0.5))
        top, bottom = max(0, math.ceil(y0 - 0.5)), min(height, math.ceil(y1 - 0.5))
        if right <= left or bottom <= top:
            continue
        x = 2 * (torch.arange(left, right) + 0.5 - x0) / (x1 - x0) - 1
        y = 2 * (torch.arange(top, bottom) + 0.5 - y0) / (y1 - y0) - 1
        grid = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=2).float()
        window = functional.grid_sample(value[None, None], grid[None], padding_mode="border", align_corners=False)
        target[top:bottom, left:right] = window[0, 0] > 0.5
    return pasted


def boxes_of_masks(masks: torch.Tensor, otherwise: torch.Tensor) -> torch.Tensor:
    """Return the tight boxes (n, 4) of masks (n, H, W) bool; an empty mask takes its row of `otherwise` (n, 4)."""
    tight = torch.from_numpy(tight_boxes(masks.numpy())).to(otherwise)
    return torch.where(masks.flatten(1).any(dim=1, keepdim=True), tight, otherwise)
