"""A small extractor without weights, and colored shapes for it to see."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torchvision.ops import roi_align

from icub_core.data import Instance, RgbdFrame
from icub_core.geometry import pinhole
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures
from icub_segmenters.heads.falkon import Falkon

COLORS = {"red": (220, 30, 30), "green": (30, 200, 40), "blue": (40, 50, 220), "yellow": (230, 220, 30)}


class WindowsExtractor(FeatureExtractor):
    """Proposes windows of three sizes; a region is its colors on a 5 x 5 grid, a pixel its color and its region's."""

    region_dim = 75
    mask_dim = 6
    mask_size = 14

    def __init__(self, sides=(24, 36, 52), stride=8):
        self.sides, self.stride = sides, stride
        self.extracted = 0

    def extract(self, rgb):
        self.extracted += 1
        height, width = rgb.shape[:2]
        boxes = [
            (x, y, x + side, y + side)
            for side in self.sides
            for y in range(0, height - side // 2, self.stride)
            for x in range(0, width - side // 2, self.stride)
        ]
        maps = torch.from_numpy(rgb.copy()).permute(2, 0, 1).float()[None] / 255
        proposals = torch.tensor(boxes, dtype=torch.float32)
        return ImageFeatures(maps, (height, width), proposals, torch.ones(len(boxes)))

    def region_features(self, features, boxes):
        return roi_align(features.maps, [boxes], 5, sampling_ratio=2, aligned=True).flatten(1)

    def mask_features(self, features, boxes):
        pooled = roi_align(features.maps, [boxes], self.mask_size, sampling_ratio=2, aligned=True)
        around = pooled.mean(dim=(2, 3), keepdim=True).expand_as(pooled)
        return torch.cat([pooled, around], dim=1).permute(0, 2, 3, 1)


def paint(objects, size=(96, 128), seed=0):
    """An RgbdFrame of discs (label, x, y, radius) on gray noise, and their instances."""
    rng = np.random.default_rng(seed)
    rgb = rng.integers(90, 150, (*size, 3)).astype(np.uint8)
    rows, columns = np.mgrid[: size[0], : size[1]]
    instances = []
    for label, x, y, radius in objects:
        mask = (rows + 0.5 - y) ** 2 + (columns + 0.5 - x) ** 2 <= radius**2
        rgb[mask] = np.clip(np.array(COLORS[label]) + rng.normal(0, 8, (int(mask.sum()), 3)), 0, 255)
        instances.append(Instance.from_mask(label, mask))
    frame = RgbdFrame(rgb, np.zeros(size, np.float32), pinhole(size[1], size[0], 0.74), np.eye(4))
    return frame, tuple(instances)


def training_images(labels, count=6, seed=0):
    """`count` frames of each label alone."""
    rng = np.random.default_rng(seed)
    for label in labels:
        for number in range(count):
            x, y, r = rng.uniform(30, 98), rng.uniform(30, 66), rng.uniform(12, 20)
            yield paint([(label, x, y, r)], seed=seed * 1000 + number)


def make_falkon():
    return Falkon(sigma=15.0, penalty=1e-5, n_centers=200, selection="balanced")


@pytest.fixture
def windows():
    return WindowsExtractor()


@pytest.fixture
def falkon():
    return make_falkon


@pytest.fixture
def painter():
    return paint


@pytest.fixture
def teacher():
    return training_images
