"""Random looks of tables, floors and lamps, so that teaching and testing never happen in the same room."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from icub_core.scene import Light, Material, Vec3

TEXTURE_SIZE = 128


def _smooth_noise(rng: np.random.Generator, cells: tuple[int, int]) -> NDArray[np.float64]:
    coarse = rng.random(cells).astype(np.float32)
    return cv2.resize(coarse, (TEXTURE_SIZE, TEXTURE_SIZE), interpolation=cv2.INTER_CUBIC).astype(np.float64)


def _pattern(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a (S, S) pattern in about 0..1: cloth, wood grain, tiles, stripes, or plain."""
    rows, columns = np.mgrid[0:TEXTURE_SIZE, 0:TEXTURE_SIZE]
    kind = rng.integers(5)
    if kind == 0:
        return _smooth_noise(rng, (int(rng.integers(8, 40)),) * 2)
    if kind == 1:  # grain runs along one direction
        grain = _smooth_noise(rng, (int(rng.integers(24, 64)), int(rng.integers(2, 5))))
        return grain if rng.random() < 0.5 else grain.T
    side = int(rng.integers(8, 33))
    if kind == 2:
        return ((rows // side + columns // side) % 2).astype(np.float64)
    if kind == 3:
        return ((rows * rng.integers(0, 2) + columns) // side % 2).astype(np.float64)
    return np.full((TEXTURE_SIZE, TEXTURE_SIZE), 0.5)


def random_surface(rng: np.random.Generator) -> Material:
    """Return a table or floor: two muted colors mixed by a random pattern, with a little fine noise."""
    first = rng.uniform(0.15, 0.85) + rng.normal(0, 0.08, 3)
    second = np.clip(first + rng.normal(0, 0.12) + rng.normal(0, 0.05, 3), 0, 1)
    mix = np.clip(_pattern(rng), 0, 1)[..., None]
    image = first * (1 - mix) + second * mix + rng.normal(0, 0.015, (TEXTURE_SIZE, TEXTURE_SIZE, 1))
    return Material(
        rgba=(1.0, 1.0, 1.0, 1.0),
        texture=(255 * np.clip(image, 0, 1)).astype(np.uint8),
        specular=float(rng.uniform(0, 0.3)),
    )


def random_lights(rng: np.random.Generator) -> tuple[Light, ...]:
    """Return one or two lamps somewhere above, of slightly warm or cold light, that together never overexpose."""
    count = int(rng.integers(1, 3))
    brightness, shade = rng.uniform(0.45, 0.75), rng.uniform(0.2, 0.32)
    return tuple(_lamp(rng, brightness / count, shade / count) for _ in range(count))


def _lamp(rng: np.random.Generator, diffuse: float, ambient: float) -> Light:
    tilt, azimuth = rng.uniform(0.1, 0.8), rng.uniform(0, 2 * np.pi)
    tint = 1 + rng.normal(0, 0.05, 3)
    return Light(
        direction=_vec3([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)]),
        diffuse=_vec3(np.clip(diffuse * tint, 0, 1)),
        ambient=_vec3(np.clip(ambient * tint, 0, 1)),
    )


def _vec3(values: ArrayLike) -> Vec3:
    x, y, z = (float(v) for v in np.asarray(values))
    return x, y, z
