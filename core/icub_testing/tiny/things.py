"""Objects and annotated images made of plain shapes."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import ConfigError, unknown_name
from icub_core.geometry import look_at, pinhole
from icub_core.interfaces.dataset import Dataset
from icub_core.interfaces.episodes import Episode, Episodes, Step
from icub_core.interfaces.object_set import ObjectSet
from icub_core.scene import Geom, Material, ObjectSpec

COLORS = {"red": (200, 40, 40), "green": (40, 170, 60), "blue": (50, 70, 200)}
SIZES = {"red": (0.03, 0.04, 0.05), "green": (0.04, 0.03, 0.06), "blue": (0.03, 0.03, 0.04)}
"""Half extents, meters."""


class TinyObjects(ObjectSet):
    """Three boxes, named by their color."""

    @property
    def names(self) -> tuple[str, ...]:
        """The colors."""
        return tuple(COLORS)

    def get(self, name: str) -> ObjectSpec:
        """Make one box that stands on its lowest face."""
        if name not in COLORS:
            raise ConfigError(unknown_name("object in the tiny set", name, COLORS))
        half = SIZES[name]
        r, g, b = (channel / 255 for channel in COLORS[name])
        return ObjectSpec(
            name,
            (Geom("box", half),),
            mass=0.2,
            half_extents=half,
            rest_height=half[2],
            material=Material((r, g, b, 1.0)),
        )


def draw_frame(
    places: dict[str, tuple[int, int, int]], seed: int = 0, size: tuple[int, int] = (120, 160)
) -> tuple[RgbdFrame, tuple[Instance, ...]]:
    """Draw discs on a gray, noisy ground; every call returns fresh arrays.

    Args:
        places: Color to column, row and radius of its disc, pixels; later ones cover earlier ones.
        seed: Of the noise.
        size: Height and width, pixels.

    Returns:
        The frame, at 1 m over a plane with the discs 10 cm nearer, and the visible part of every disc.
    """
    drawn = _drawn(tuple(places.items()), seed, size)
    rgb, depth, owner = drawn[0].copy(), drawn[1].copy(), drawn[2]
    T_world_camera = look_at([0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
    frame = RgbdFrame(rgb, depth, pinhole(size[1], size[0], 0.8), T_world_camera)
    masks: dict[str, NDArray[np.bool_]] = {color: owner == i for i, color in enumerate(places)}
    return frame, tuple(Instance.from_mask(color, mask) for color, mask in masks.items() if mask.any())


@functools.lru_cache(maxsize=64)
def _drawn(
    places: tuple[tuple[str, tuple[int, int, int]], ...], seed: int, size: tuple[int, int]
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int64]]:
    """Return image, depth and the number of the disc that each pixel shows (-1 the ground)."""
    rng = np.random.default_rng(seed)
    rgb = rng.integers(110, 150, (*size, 3), dtype=np.uint8)
    depth = np.ones(size, dtype=np.float32)
    owner = np.full(size, -1)
    rows, columns = np.mgrid[: size[0], : size[1]]
    for i, (color, (x, y, radius)) in enumerate(places):
        disc = (columns - x) ** 2 + (rows - y) ** 2 <= radius**2
        noise = rng.integers(-10, 10, (int(disc.sum()), 3))
        rgb[disc] = np.clip(np.asarray(COLORS[color]) + noise, 0, 255).astype(np.uint8)
        depth[disc], owner[disc] = 0.9, i
    return rgb, depth, owner


class TinyDataset(Dataset):
    """Images of the colored discs.

    Args:
        length: Number of images.
        seed: Decides all of them.
    """

    def __init__(self, length: int = 4, seed: int = 0) -> None:
        self._length = length
        self._seed = seed

    @property
    def classes(self) -> tuple[str, ...]:
        """The colors."""
        return tuple(COLORS)

    def __len__(self) -> int:
        """Number of images."""
        return self._length

    def __getitem__(self, index: int) -> tuple[RgbdFrame, tuple[Instance, ...]]:
        """Draw image `index`."""
        if not 0 <= index < self._length:
            raise IndexError(f"image {index} of {self._length}")
        rng = np.random.default_rng([self._seed, index])
        colors = rng.permutation(list(COLORS))[: int(rng.integers(1, 4))]
        places = {
            str(c): (int(rng.integers(20, 140)), int(rng.integers(20, 100)), int(rng.integers(8, 18))) for c in colors
        }
        return draw_frame(places, seed=int(rng.integers(2**31)))


class TinyEpisode(Episode):
    """A hand that carries a disc to the right: one image, its place and its velocity per step.

    Args:
        color: Of the disc; also decides the noise.
        length: Number of steps.
    """

    def __init__(self, color: str, length: int) -> None:
        self._color = color
        self._length = length

    @property
    def task(self) -> str:
        """What all demonstrations of this color share."""
        return f"carry {self._color}"

    @property
    def instruction(self) -> str:
        """The task in words."""
        return f"Carry the {self._color} disc to the right."

    def __len__(self) -> int:
        """Number of steps."""
        return self._length

    def __getitem__(self, index: int) -> Step:
        """Draw step `index`."""
        if not 0 <= index < self._length:
            raise IndexError(f"step {index} of {self._length}")
        frame, _ = draw_frame({self._color: (30 + 10 * index, 60, 12)}, seed=index)
        velocity = [0.1 if index + 1 < self._length else 0.0, 0.0, 0.0]
        state = {"position": np.array([0.1 * index, 0.0, 0.2]), "velocity": np.array(velocity)}
        return Step({"camera": frame.rgb}, {"camera": frame.depth}, state, np.array(velocity))


class TinyEpisodes(Episodes):
    """One demonstration per color.

    Args:
        steps: Steps of every episode.
    """

    def __init__(self, steps: int = 3) -> None:
        self._episodes = tuple(TinyEpisode(color, steps) for color in COLORS)

    def __len__(self) -> int:
        """Number of episodes."""
        return len(self._episodes)

    def __getitem__(self, index: int) -> Episode:
        """Return the episode of one color."""
        return self._episodes[index]
