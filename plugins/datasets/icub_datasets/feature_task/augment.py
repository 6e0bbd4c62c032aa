"""Augmentation of labeled frames on the fly: copy-paste, flip, zoom, light and noise."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from icub_datasets.feature_task.renderer import MIN_PIXELS, LabeledImage


def _relabel(rgb: NDArray[np.uint8], instances: NDArray[np.uint8], labels: NDArray[np.int64]) -> LabeledImage:
    """Drop instances of which too little is visible."""
    counts = np.bincount(instances.ravel(), minlength=len(labels) + 1)[: len(labels) + 1]
    keep = np.flatnonzero(counts[1:] >= MIN_PIXELS)
    table = np.zeros(len(labels) + 1, dtype=np.uint8)
    table[keep + 1] = np.arange(1, len(keep) + 1)
    return LabeledImage(rgb, table[instances], labels[keep])


def copy_paste(rng: np.random.Generator, target: LabeledImage, source: LabeledImage) -> LabeledImage:
    """Paste 1 to 4 objects of `source` into `target`, moved and resized, with one softened pixel of border."""
    if len(source.labels) == 0:
        return target
    height, width = target.instances.shape
    rgb, instances = target.rgb.copy(), target.instances.copy()
    labels = list(target.labels)
    for pick in rng.permutation(len(source.labels))[: int(rng.integers(1, 5))]:
        mask = (source.instances == pick + 1).astype(np.uint8)
        x, y, w, h = cv2.boundingRect(mask)
        scale = min(rng.uniform(0.6, 1.5), 0.8 * height / h, 0.8 * width / w)
        center = rng.uniform([0.05 * width, 0.05 * height], [0.95 * width, 0.95 * height])
        # only the square around the pasted object is touched: a full frame of floats for each would cost the most
        half = int(np.ceil(scale * np.hypot(w, h) / 2)) + 1
        left, top = int(center[0]) - half, int(center[1]) - half
        turn = np.asarray(
            cv2.getRotationMatrix2D((x + w / 2, y + h / 2), float(rng.uniform(-25, 25)), float(scale)), np.float64
        )
        turn[:, 2] += (half - (x + w / 2), half - (y + h / 2))
        side = (2 * half, 2 * half)
        moved = cv2.warpAffine(mask * 255, turn, side, flags=cv2.INTER_LINEAR)
        colors = cv2.warpAffine(source.rgb, turn, side, flags=cv2.INTER_LINEAR)
        rows = slice(max(top, 0), min(top + 2 * half, height))
        columns = slice(max(left, 0), min(left + 2 * half, width))
        inside = (slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left))
        moved, colors = moved[inside], colors[inside]
        if cv2.countNonZero(moved) < MIN_PIXELS:
            continue
        alpha = cv2.erode(moved, np.ones((2, 2), np.uint8)).astype(np.float32)[..., None] / 255
        rgb[rows, columns] = (colors * alpha + rgb[rows, columns] * (1 - alpha)).astype(np.uint8)
        labels.append(int(source.labels[pick]))
        instances[rows, columns][moved > 127] = len(labels)
    return LabeledImage(rgb, instances, np.array(labels, dtype=np.int64))


def _zoom(rng: np.random.Generator, frame: LabeledImage) -> LabeledImage:
    """Scale by 0.75 to 1.6 about a random point and mirror half of the frames."""
    height, width = frame.instances.shape
    scale = float(np.exp(rng.uniform(np.log(0.75), np.log(1.6))))
    slack = np.array([width, height]) * (1 - scale)
    shift = rng.uniform(np.minimum(slack, 0), np.maximum(slack, 0))
    matrix = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    if rng.random() < 0.5:
        matrix[0] = -matrix[0] + [0, 0, width - 1]
    size = (width, height)
    rgb = cv2.warpAffine(frame.rgb, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    instances = cv2.warpAffine(frame.instances, matrix, size, flags=cv2.INTER_NEAREST)
    if scale < 1.0:
        # what the reflected border shows is an object without a label: paint it over
        inside = cv2.warpAffine(np.full((height, width), 255, np.uint8), matrix, size, flags=cv2.INTER_NEAREST)
        rgb[inside == 0] = rng.integers(0, 256, size=3)
    return LabeledImage(np.asarray(rgb, np.uint8), np.asarray(instances, np.uint8), frame.labels)


def _light(rng: np.random.Generator, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Brightness, contrast, white balance, gamma, blur and noise."""
    levels = np.arange(256, dtype=np.float64)[:, None]
    levels = (levels - 110) * rng.uniform(0.7, 1.3) + 110 + rng.uniform(-20, 45)
    levels = np.clip(levels * rng.uniform(0.88, 1.12, size=3), 0, 255)
    levels = 255 * (levels / 255) ** rng.uniform(0.7, 1.3)
    image = cv2.LUT(rgb, levels[None].astype(np.uint8))
    kind = rng.random()
    if kind < 0.2:
        image = cv2.GaussianBlur(image, (3, 3), float(rng.uniform(0.3, 1.0)))
    elif kind < 0.5:
        noise: Any = np.empty(image.shape, dtype=np.int16)
        cv2.randn(noise, 0, float(rng.uniform(1, 8)))  # type: ignore[call-overload]
        image = cv2.add(image, noise, dtype=cv2.CV_8U)
    return np.asarray(image, np.uint8)


def augment(rng: np.random.Generator, frame: LabeledImage, other: LabeledImage) -> LabeledImage:
    """Return a varied copy of `frame`, at times with objects of `other`; instances below 50 pixels are dropped."""
    cv2.setRNGSeed(int(rng.integers(2**31 - 1)))
    if rng.random() < 0.6:
        frame = copy_paste(rng, frame, other)
    frame = _zoom(rng, frame)
    return _relabel(_light(rng, frame.rgb), frame.instances, frame.labels)
