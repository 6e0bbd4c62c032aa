"""Procedural textures: surfaces of invented products, and of tables, walls and floors.

Everything is drawn from a random generator, so that the same seed gives the same pixels and nothing has to be
downloaded. Product textures are cube maps because the meshes of ``pybullet_data`` carry no texture coordinates.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

CUBE_FACES = 6


def _color(rng: np.random.Generator) -> NDArray[np.float64]:
    """A color (3,) in 0..255: uniform in hue, mostly saturated, at times gray, white or black."""
    kind = rng.random()
    if kind < 0.12:
        value = rng.uniform(200, 255) if rng.random() < 0.6 else rng.uniform(15, 60)
        return np.full(3, value)
    hsv = np.array([[[rng.uniform(0, 180), rng.uniform(60, 255), rng.uniform(70, 255)]]], dtype=np.uint8)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0].astype(np.float64)


def smooth_noise(rng: np.random.Generator, size: int, cells: int, octaves: int = 3) -> NDArray[np.float32]:
    """Noise (size, size) in 0..1, a sum of octaves of interpolated random grids."""
    total = np.zeros((size, size), dtype=np.float32)
    for octave in range(octaves):
        side = min(size, cells * 2**octave)
        grid = rng.random((side, side), dtype=np.float32)
        total += cv2.resize(grid, (size, size), interpolation=cv2.INTER_CUBIC) * 0.5**octave
    low, high = float(total.min()), float(total.max())
    return (total - low) / max(high - low, 1e-6)


def _mix(mask: NDArray[np.float32], a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float32]:
    """Blend two colors (3,) by a mask (size, size) in 0..1."""
    return (mask[..., None] * a + (1 - mask[..., None]) * b).astype(np.float32)


def _stripes(rng: np.random.Generator, size: int) -> NDArray[np.float32]:
    angle = rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)])
    y, x = np.mgrid[0:size, 0:size].astype(np.float32) / size
    wave = np.sin((x * np.cos(angle) + y * np.sin(angle)) * 2 * np.pi * rng.integers(1, 9))
    return (wave > rng.uniform(-0.6, 0.6)).astype(np.float32)


def _checks(rng: np.random.Generator, size: int) -> NDArray[np.float32]:
    nx, ny = rng.integers(2, 9, size=2)
    y, x = np.mgrid[0:size, 0:size]
    return (((x * nx) // size + (y * ny) // size) % 2).astype(np.float32)


def _blobs(rng: np.random.Generator, size: int) -> NDArray[np.float32]:
    image = np.zeros((size, size), dtype=np.uint8)
    for _ in range(int(rng.integers(4, 25))):
        axes = tuple(int(v) for v in rng.integers(size // 32 + 1, size // 6, size=2))
        center = tuple(int(v) for v in rng.integers(0, size, size=2))
        cv2.ellipse(image, center, axes, float(rng.uniform(0, 180)), 0, 360, 255, -1, cv2.LINE_AA)
    return np.asarray(image, np.float32) / np.float32(255)


def _write_text(rng: np.random.Generator, face: NDArray[np.uint8], lines: int) -> None:
    """Write invented words on a face (size, size, 3) uint8, in place."""
    size = face.shape[0]
    letters = np.array(list("ABCDEFGHIKLMNOPRSTUVWXYZ0123456789"))
    for _ in range(lines):
        word = "".join(rng.choice(letters, size=int(rng.integers(2, 8))))
        scale = float(rng.uniform(0.3, 1.6)) * size / 128
        place = (int(rng.integers(-size // 8, size // 2)), int(rng.integers(size // 8, size)))
        color = tuple(float(c) for c in _color(rng))
        cv2.putText(face, word, place, int(rng.integers(0, 8)), scale, color, int(rng.integers(1, 4)), cv2.LINE_AA)


def _label_face(rng: np.random.Generator, size: int, palette: NDArray[np.float64]) -> NDArray[np.uint8]:
    """A printed face: base color, one or two bands, a logo and words."""
    face = np.full((size, size, 3), palette[0], dtype=np.float64).astype(np.uint8)
    for color in palette[1 : 1 + int(rng.integers(1, 3))]:
        a, b = sorted(int(v) for v in rng.integers(0, size, size=2))
        if rng.random() < 0.75:
            face[a : b + 8] = color
        else:
            face[:, a : b + 8] = color
    if rng.random() < 0.7:
        center = tuple(int(v) for v in rng.integers(size // 4, 3 * size // 4, size=2))
        axes = tuple(int(v) for v in rng.integers(size // 12, size // 3, size=2))
        cv2.ellipse(face, center, axes, 0.0, 0, 360, tuple(float(c) for c in palette[-1]), -1, cv2.LINE_AA)
    _write_text(rng, face, int(rng.integers(1, 5)))
    return face


def product_texture(rng: np.random.Generator, size: int = 128) -> NDArray[np.uint8]:
    """Draw the surface of one invented product as a cube map.

    Args:
        rng: Source of all randomness.
        size: Side of a face, pixels.

    Returns:
        (6 * size, size, 3) uint8, the six faces one below the other.
    """
    palette = np.stack([_color(rng) for _ in range(4)])
    style = rng.choice(["plain", "noise", "stripes", "checks", "blobs", "label"], p=[0.1, 0.12, 0.14, 0.1, 0.14, 0.4])
    faces: list[NDArray[np.uint8]] = []
    twin = rng.random() < 0.5  # opposite faces of a package often look alike
    for index in range(CUBE_FACES):
        if twin and index % 2 == 1 and style == "label":
            faces.append(faces[-1].copy())
            continue
        if style == "label":
            plain = index in (4, 5) and rng.random() < 0.5
            face = np.full((size, size, 3), palette[0]).astype(np.uint8) if plain else _label_face(rng, size, palette)
        else:
            if style == "stripes":
                mask = _stripes(rng, size)
            elif style == "checks":
                mask = _checks(rng, size)
            elif style == "blobs":
                mask = _blobs(rng, size)
            elif style == "noise":
                mask = smooth_noise(rng, size, int(rng.integers(2, 12)))
            else:
                mask = np.ones((size, size), dtype=np.float32)
            face = np.clip(_mix(mask, palette[0], palette[1]), 0, 255).astype(np.uint8)
            if rng.random() < 0.25:
                _write_text(rng, face, 1)
        grain = (smooth_noise(rng, size, 16, 2) - 0.5) * rng.uniform(0, 30)
        faces.append(np.clip(face.astype(np.float32) + grain[..., None], 0, 255).astype(np.uint8))
    return np.concatenate(faces)


def background_texture(rng: np.random.Generator, size: int = 256) -> NDArray[np.uint8]:
    """Draw a table, wall or floor: (size, size, 3) uint8."""
    a, b = _color(rng), _color(rng)
    if rng.random() < 0.6:  # most furniture is less colorful than products
        a, b = a * 0.35 + a.mean() * 0.65, b * 0.35 + b.mean() * 0.65
    style = rng.choice(["wood", "noise", "tiles", "stripes", "plain", "print"])
    if style == "wood":
        grain = cv2.resize(smooth_noise(rng, size, 8), (size, size))
        rings = np.sin((np.linspace(0, 1, size)[:, None] * rng.uniform(8, 40) + grain * rng.uniform(2, 8)) * np.pi)
        mask = (0.5 + 0.5 * rings).astype(np.float32)
        b = a * rng.uniform(0.6, 0.9)
    elif style == "noise":
        mask = smooth_noise(rng, size, int(rng.integers(2, 40)))
    elif style == "tiles":
        mask = _checks(rng, size)
        b = a * rng.uniform(0.5, 1.0) if rng.random() < 0.5 else b
    elif style == "stripes":
        mask = _stripes(rng, size)
    elif style == "print":
        mask = _blobs(rng, size)
    else:
        mask = np.ones((size, size), dtype=np.float32)
    image = _mix(mask, a, b) + (smooth_noise(rng, size, 32, 3)[..., None] - 0.5) * rng.uniform(5, 50)
    image = np.clip(image, 0, 255).astype(np.uint8)
    if style == "print":
        _write_text(rng, image, int(rng.integers(0, 5)))
    return image
