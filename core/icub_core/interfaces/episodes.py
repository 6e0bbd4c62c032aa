"""Episodes: recorded demonstrations, step by step, each with an instruction in words."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Step:
    """What a robot saw and measured at one moment, and what it was commanded then.

    Attributes:
        rgb: Camera to (H, W, 3) uint8.
        depth: Camera to (H, W) float32, meters, 0 where nothing was measured.
        state: Measured quantity to its values (k,), SI units, quaternions as wxyz.
        action: (a,) command, in the same units.
    """

    rgb: Mapping[str, NDArray[np.uint8]]
    depth: Mapping[str, NDArray[np.float32]]
    state: Mapping[str, FloatArray]
    action: FloatArray


class Episode(ABC):
    """One demonstration, from start to end."""

    @property
    @abstractmethod
    def task(self) -> str:
        """Name of the task, shared by all its demonstrations."""

    @property
    @abstractmethod
    def instruction(self) -> str:
        """What the robot was told, in words; empty where nothing was said."""

    @abstractmethod
    def __len__(self) -> int:
        """Number of steps."""

    @abstractmethod
    def __getitem__(self, index: int) -> Step:
        """Read one step. Raises IndexError past the end, DataError naming a file that cannot be read."""

    def __iter__(self) -> Iterator[Step]:
        """Read all steps in order."""
        return (self[index] for index in range(len(self)))


class Episodes(ABC):
    """A finite, indexable set of episodes.

    Contract: an episode has at least one step; cameras, quantities and their sizes are the same in every step of an
    episode; step i is the same at every reading.
    """

    @abstractmethod
    def __len__(self) -> int:
        """Number of episodes."""

    @abstractmethod
    def __getitem__(self, index: int) -> Episode:
        """Return one episode, whose steps may be read later. Raises IndexError past the end."""

    def __iter__(self) -> Iterator[Episode]:
        """Return all episodes in order."""
        return (self[index] for index in range(len(self)))
