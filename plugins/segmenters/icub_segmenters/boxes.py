"""Boxes in pixels, x0 y0 x1 y1 with exclusive ends, as (N, 4) float32 tensors."""

from __future__ import annotations

import math

import torch

MAX_LOG_GROWTH = math.log(1000.0 / 16.0)
"""Refinement may not grow a side by more: the released detector has no such guard and its exponential can overflow."""


def iou(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return intersection over union (n, m) of boxes a (n, 4) and b (m, 4); 0 for boxes without area."""
    top_left = torch.maximum(a[:, None, :2], b[None, :, :2])
    bottom_right = torch.minimum(a[:, None, 2:], b[None, :, 2:])
    intersection = (bottom_right - top_left).clamp(min=0).prod(dim=2)
    area_a = (a[:, 2:] - a[:, :2]).clamp(min=0).prod(dim=1)
    area_b = (b[:, 2:] - b[:, :2]).clamp(min=0).prod(dim=1)
    union = area_a[:, None] + area_b[None] - intersection
    return torch.where(union > 0, intersection / union.clamp(min=1e-9), 0.0)


def paired_iou(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the IoU (n,) of each box of a (n, 4) with its partner in b (n, 4)."""
    overlap = torch.minimum(a[:, 2:], b[:, 2:]) - torch.maximum(a[:, :2], b[:, :2])
    intersection = overlap.clamp(min=0).prod(dim=1)
    areas = (a[:, 2:] - a[:, :2]).clamp(min=0).prod(dim=1) + (b[:, 2:] - b[:, :2]).clamp(min=0).prod(dim=1)
    return intersection / (areas - intersection).clamp(min=1e-9)


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
    box: torch.Tensor, count: int, lowest_iou: float, image_size: tuple[int, int], generator: torch.Generator
) -> torch.Tensor:
    """Draw up to `count` boxes (count, 4) near box (4,) whose IoU with it is at least `lowest_iou`."""
    tries = 4 * count
    noise = torch.randn(tries, 4, generator=generator) * torch.tensor([0.1, 0.1, 0.15, 0.15])
    drawn = decode(box.expand(tries, 4), noise, image_size)
    good = iou(drawn, box[None]).squeeze(1) >= lowest_iou
    return drawn[good][:count]


def _size(boxes: torch.Tensor) -> torch.Tensor:
    return (boxes[:, 2:] - boxes[:, :2]).clamp(min=1.0)
