"""Boxes in pixels, x0 y0 x1 y1 with exclusive ends, as (N, 4) float32 tensors."""

from __future__ import annotations

import math

import torch

from icub_support.overlap import box_iou, paired_box_iou

MAX_LOG_GROWTH = math.log(1000.0 / 16.0)
"""Refinement may not grow a side by more: the released detector has no such guard and its exponential can overflow."""


def iou(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return intersection over union (n, m) of boxes a (n, 4) and b (m, 4); 0 for boxes without area."""
    return torch.from_numpy(box_iou(a.numpy(), b.numpy()))


def paired_iou(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the IoU (n,) of each box of a (n, 4) with its partner in b (n, 4)."""
    return torch.from_numpy(paired_box_iou(a.numpy(), b.numpy()))


def encode(boxes: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    """Return what moves each box onto its target: (gx - x) / w, (gy - y) / h, log(gw / w), log(gh / h); (N, 4)."""
    size, target_size = _size(boxes), _size(targets)
    shift = (targets[:, :2] + targets[:, 2:] - boxes[:, :2] - boxes[:, 2:]) / 2 / size
    return torch.cat([shift, (target_size / size).log()], dim=1)


def decode(boxes: torch.Tensor, deltas: torch.Tensor, image_size: tuple[int, int]) -> torch.Tensor:
    """Apply refinements (N, 4) to boxes (N, 4) and clip to an image of (height, width)."""
    size = _size(boxes)
    center = (boxes[:, :2] + boxes[:, 2:]) / 2 + deltas[:, :2] * size
    half = size * deltas[:, 2:].clamp(max=MAX_LOG_GROWTH).exp() / 2
    return clip(torch.cat([center - half, center + half], dim=1), image_size)


def clip(boxes: torch.Tensor, image_size: tuple[int, int]) -> torch.Tensor:
    """Cut boxes (N, 4) to an image of (height, width), leaving each at least one pixel wide and high."""
    height, width = image_size
    limit = boxes.new_tensor([width, height])
    low = torch.minimum(boxes[:, :2].clamp(min=0), limit - 1)
    high = torch.minimum(torch.maximum(boxes[:, 2:], low + 1), limit)
    return torch.cat([low, high], dim=1)


def jittered(
    box: torch.Tensor, count: int, min_iou: float, image_size: tuple[int, int], generator: torch.Generator
) -> torch.Tensor:
    """Draw up to `count` boxes (count, 4) near box (4,) whose IoU with it is at least `min_iou`."""
    tries = 4 * count
    noise = torch.randn(tries, 4, generator=generator) * torch.tensor([0.1, 0.1, 0.15, 0.15])
    drawn = decode(box.expand(tries, 4), noise, image_size)
    good = iou(drawn, box[None]).squeeze(1) >= min_iou
    return drawn[good][:count]


def _size(boxes: torch.Tensor) -> torch.Tensor:
    return (boxes[:, 2:] - boxes[:, :2]).clamp(min=1.0)
