"""Dataset: annotated RGB-D (or RGB) images."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

from icub_core.data import Instance, RgbdFrame


class Dataset(ABC):
    """A finite, indexable set of annotated frames.

    Contract: `classes` has no duplicates; every label of every instance is one of them; item i is the same at every
    reading; masks and boxes agree with the image size; a set without depth gives depth 0 everywhere; iterating gives
    the items in order, and may leave out those that cannot be read, with a warning in the log; a set with several
    splits is one of them, chosen by its constructor's parameter `split`. A set that holds files or an engine also has
    the ability `Closable`.
    """

    @property
    @abstractmethod
    def classes(self) -> tuple[str, ...]:
        """Class names in a fixed order."""

    @property
    def splits(self) -> tuple[str, ...]:
        """Names that the constructor's parameter `split` chooses from; ``("all",)`` for a set that is not split."""
        return ("all",)

    @abstractmethod
    def __len__(self) -> int:
        """Number of frames."""

    @abstractmethod
    def __getitem__(self, index: int) -> tuple[RgbdFrame, tuple[Instance, ...]]:
        """Frame and its instances. Raises IndexError past the end, DataError naming the file for a corrupt item."""

    def __iter__(self) -> Iterator[tuple[RgbdFrame, tuple[Instance, ...]]]:
        """Read all frames in order."""
        for index in range(len(self)):
            yield self[index]
