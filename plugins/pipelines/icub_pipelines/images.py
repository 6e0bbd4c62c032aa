"""Images for people: masks drawn on images, contact sheets, animations."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import cv2
import imageio.v3 as iio
import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance
from icub_core.files import write_bytes_atomically

Image = NDArray[np.uint8]


def color_of(label: str) -> tuple[int, int, int]:
    """Return a bright RGB color that is always the same for one label."""
    hue = int.from_bytes(hashlib.sha256(label.encode()).digest()[:2], "big") % 180
    rgb = cv2.cvtColor(np.array([[[hue, 210, 255]]], np.uint8), cv2.COLOR_HSV2RGB)[0, 0]
    return int(rgb[0]), int(rgb[1]), int(rgb[2])


def draw_instances(rgb: Image, instances: Sequence[Instance]) -> Image:
    """Return a copy of an image (H, W, 3) with masks, boxes and names of the instances drawn on it."""
    canvas = rgb.copy()
    for instance in instances:
        color = color_of(instance.label)
        canvas[instance.mask] = (0.55 * canvas[instance.mask] + 0.45 * np.array(color)).astype(np.uint8)
        outlines, _ = cv2.findContours(instance.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(canvas, outlines, -1, color, 1)
    for instance in instances:  # names last, so that no mask covers them
        x, y = int(instance.box[0]), int(instance.box[1])
        caption = f"{instance.label} {instance.score:.2f}"
        _write(canvas, caption, (max(x, 1), max(y - 3, 9)), color_of(instance.label))
    return canvas


def _write(canvas: Image, text: str, origin: tuple[int, int], color: tuple[int, int, int]) -> None:
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.33, 1)
    x, y = min(origin[0], max(canvas.shape[1] - width - 2, 0)), origin[1]
    cv2.rectangle(canvas, (x - 1, y - height - 1), (x + width + 1, y + 3), (20, 20, 20), cv2.FILLED)
    cv2.putText(canvas, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.33, color, 1, cv2.LINE_AA)


def captioned(rgb: Image, text: str) -> Image:
    """Return a copy of an image with one line of text in its lower left corner."""
    canvas = rgb.copy()
    _write(canvas, text, (5, canvas.shape[0] - 6), (255, 255, 255))
    return canvas


def contact_sheet(images: Sequence[Image], columns: int) -> Image:
    """Lay images of one size out in rows of `columns`; missing ones stay black."""
    height, width = images[0].shape[:2]
    rows = -(-len(images) // columns)
    sheet = np.zeros((rows * height, columns * width, 3), np.uint8)
    for i, image in enumerate(images):
        y, x = divmod(i, columns)
        sheet[y * height : (y + 1) * height, x * width : (x + 1) * width] = image
    return sheet


def save_image(path: Path, rgb: Image) -> None:
    """Write an image as PNG or JPEG, by the suffix of `path`."""
    write_bytes_atomically(path, iio.imwrite("<bytes>", rgb, extension=path.suffix))


def save_animation(path: Path, frames: Sequence[Image], frames_per_second: float) -> None:
    """Write frames of one size as an endless GIF."""
    content = iio.imwrite("<bytes>", np.stack(frames), extension=".gif", duration=1000 / frames_per_second, loop=0)
    write_bytes_atomically(path, content)
