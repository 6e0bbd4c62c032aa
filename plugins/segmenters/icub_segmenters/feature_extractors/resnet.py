"""ResNet-50 as the detection checkpoints have it, and the translation of Detectron2's names into torchvision's."""

from __future__ import annotations

import re
from collections.abc import Mapping

import torch
from torch import nn
from torchvision.models.resnet import Bottleneck, ResNet
from torchvision.ops import FrozenBatchNorm2d

# Detectron2 expects BGR, 0..255; torchvision RGB, 0..1
DETECTRON_MEAN_BGR = (103.530, 116.280, 123.675)
TORCHVISION_MEAN_RGB, TORCHVISION_STD_RGB = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
DETECTRON, TORCHVISION = "detectron2", "torchvision"
# kept in Detectron2's files although they are configuration, not weights
_NOT_WEIGHTS = ("pixel_mean", "pixel_std", "proposal_generator.anchor_generator.")


class Norm(FrozenBatchNorm2d):
    """Batch normalization with fixed statistics; torchvision's COCO weights were made with eps 0, Detectron2's 1e-5."""


def resnet50(layout: str) -> ResNet:
    """Build ResNet-50 with frozen normalization and random weights.

    Args:
        layout: With "detectron2" the stride of a stage sits in the first 1x1 convolution (the original of He et al.
            2016), with "torchvision" in the 3x3 convolution.
    """
    eps = 1e-5 if layout == DETECTRON else 0.0
    network = ResNet(Bottleneck, [3, 4, 6, 3], norm_layer=lambda channels: Norm(channels, eps))
    if layout == DETECTRON:
        for stage in (network.layer2, network.layer3, network.layer4):
            stage[0].conv1.stride, stage[0].conv2.stride = (2, 2), (1, 1)
    return network


def layout_of(tensors: Mapping[str, torch.Tensor]) -> str | None:
    """Return whose names a state dictionary has: "detectron2", "torchvision" or None."""
    if any(key.startswith("proposal_generator.rpn_head.") for key in tensors):
        return DETECTRON
    if any(key.startswith("rpn.head.") for key in tensors):
        return TORCHVISION
    return None


def preprocess(image: torch.Tensor, layout: str) -> torch.Tensor:
    """Turn an RGB image (3, H, W) 0..255 into what the weights of a layout were trained with."""
    if layout == DETECTRON:
        return image.flip(0) - torch.tensor(DETECTRON_MEAN_BGR)[:, None, None]
    mean, std = (torch.tensor(v)[:, None, None] for v in (TORCHVISION_MEAN_RGB, TORCHVISION_STD_RGB))
    return (image / 255.0 - mean) / std


def shorter_side_size(height: int, width: int, shorter: int, longest: int) -> tuple[int, int]:
    """Size with the shorter side `shorter`, unless the longer one would exceed `longest`."""
    scale = min(shorter / min(height, width), longest / max(height, width))
    return max(32, round(height * scale)), max(32, round(width * scale))


def background_first(tensor: torch.Tensor) -> torch.Tensor:
    """Move Detectron2's last class, the background, to the front, where torchvision has it."""
    return torch.cat([tensor[-1:], tensor[:-1]])


def with_background(tensor: torch.Tensor, rows: int) -> torch.Tensor:
    """Put `rows` of zeros for the background, which Detectron2 has no boxes and masks for, in front."""
    return torch.cat([torch.zeros(rows, *tensor.shape[1:], dtype=tensor.dtype), tensor])


def rename_trunk(key: str, prefix: str, body: str) -> str | None:
    """Translate the name of one of Detectron2's trunk tensors into torchvision's, or return None.

    Args:
        key: Such as ``backbone.res2.0.conv1.norm.weight``.
        prefix: What stands before ``stem`` or ``res2`` there, such as ``backbone.``.
        body: What shall stand before ``conv1`` or ``layer1``, such as ``backbone.body.``.
    """
    if not key.startswith(prefix):
        return None
    rest = key.removeprefix(prefix)
    if match := re.fullmatch(r"stem\.conv1\.(norm\.)?(\w+)", rest):
        return f"{body}{'bn1' if match[1] else 'conv1'}.{match[2]}"
    match = re.fullmatch(r"res([2-5])\.(\d+)\.(shortcut|conv([1-3]))\.(norm\.)?(\w+)", rest)
    if match is None:
        return None
    stage, block, part, number, norm, leaf = match.groups()
    if part == "shortcut":
        name = f"downsample.{1 if norm else 0}"
    else:
        name = f"{'bn' if norm else 'conv'}{number}"
    return f"{body}layer{int(stage) - 1}.{block}.{name}.{leaf}"


def without_configuration(tensors: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Drop what Detectron2 stores beside the weights."""
    return {key: value for key, value in tensors.items() if not key.startswith(_NOT_WEIGHTS)}


def freeze(module: nn.Module) -> nn.Module:
    """Make a module a constant."""
    return module.eval().requires_grad_(False)
