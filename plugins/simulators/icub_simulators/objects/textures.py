"""Procedural surface prints: what a product or a toy might wear. Square images for cube mapping, deterministic."""

from __future__ import annotations

import colorsys
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

Rgb = tuple[int, int, int]
Pattern = Literal["label", "stripes", "bands", "checks", "blobs", "rings", "dots", "speckle", "diagonal", "plain"]
PATTERNS: tuple[Pattern, ...] = get_args(Pattern)
TEXTURE_SIZE = 128


def print_texture(
    pattern: Pattern, base: Rgb, ink: Rgb, seed: int, text: str = "", size: int = TEXTURE_SIZE
) -> NDArray[np.uint8]:
    """Draw a print.

    Args:
        pattern: Kind of print.
        base: Color of the surface, 0..255.
        ink: Color of what is printed on it.
        seed: Decides the details; the same arguments give the same image.
        text: Letters on a ``"label"``.
        size: Side of the image, pixels.

    Returns:
        (size, size, 3) uint8.
    """
    rng = np.random.default_rng(seed)
    image = np.empty((size, size, 3), np.uint8)
    image[:] = base
    y, x = np.mgrid[0:size, 0:size] / size
    period = rng.uniform(0.14, 0.3)
    phase = rng.uniform(0, period)
    if pattern == "label":
        _draw_label(image, ink, rng, text)
    elif pattern in ("stripes", "bands", "diagonal"):
        along = {"stripes": x, "bands": y, "diagonal": 0.7 * (x + y)}[pattern]
        image[(along + phase) % period < period * rng.uniform(0.3, 0.6)] = ink
    elif pattern == "checks":
        image[((x + phase) // period + (y + phase) // period) % 2 == 1] = ink
    elif pattern == "rings":
        cx, cy = rng.uniform(0.25, 0.75, 2)
        image[np.hypot(x - cx, y - cy) % period < 0.45 * period] = ink
    elif pattern == "dots":
        image[np.hypot((x + phase) % period - period / 2, (y + phase) % period - period / 2) < 0.33 * period] = ink
    elif pattern == "blobs":
        field = cv2.resize(rng.standard_normal((8, 8)).astype(np.float32), (size, size), interpolation=cv2.INTER_CUBIC)
        image[field > 0.25] = ink
    elif pattern == "speckle":
        image[rng.random((size, size)) < 0.12] = ink
    shade = 1.0 + 0.06 * cv2.resize(rng.standard_normal((16, 16)).astype(np.float32), (size, size))
    return np.clip(image * shade[..., None], 0, 255).astype(np.uint8)


def _draw_label(image: NDArray[np.uint8], ink: Rgb, rng: np.random.Generator, text: str) -> None:
    """Draw a light field with a colored band, a line of letters and rows of small print."""
    s = len(image)
    top, bottom = int(s * rng.uniform(0.12, 0.25)), int(s * rng.uniform(0.68, 0.85))
    paper = tuple(int(c) for c in rng.integers(215, 250, 3))
    cv2.rectangle(image, (int(0.08 * s), top), (int(0.92 * s), bottom), paper, -1)
    cv2.rectangle(image, (int(0.08 * s), top), (int(0.92 * s), top + int(0.2 * s)), ink, -1)
    letters = text or "".join(rng.choice(list("ABCDEFGHKLMNOPRSTUVZ"), 5))
    scale = 0.7 * s / (18.0 * max(len(letters), 4))
    cv2.putText(
        image, letters, (int(0.12 * s), top + int(0.44 * s)), cv2.FONT_HERSHEY_DUPLEX, scale, ink, max(1, s // 64)
    )
    for row in range(top + int(0.52 * s), bottom - 2, max(3, s // 24)):
        cv2.line(image, (int(0.14 * s), row), (int(s * rng.uniform(0.5, 0.86)), row), (90, 90, 90), 1)


def random_ink(rng: np.random.Generator) -> Rgb:
    """Draw a saturated color, uniform in hue."""
    r, g, b = colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.5, 1.0), rng.uniform(0.35, 1.0))
    return int(255 * r), int(255 * g), int(255 * b)
