"""What readers of data sets on disk share: a list of items, read one at a time, and what to do about bad ones."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import Generic, Literal, TypeVar, get_args

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import ConfigError, DataError, unknown_name
from icub_core.interfaces.dataset import Dataset

logger = logging.getLogger(__name__)

Item = TypeVar("Item")
Sample = tuple[RgbdFrame, tuple[Instance, ...]]
OnError = Literal["refuse", "skip"]


class FileDataset(Dataset, Generic[Item]):
    """Annotated frames in files, read when asked for.

    A subclass sets the items in its constructor and reads one in `_read`.

    Args:
        classes: Class names, in the order of the data set.
        items: What `_read` needs to find each frame.
        on_error: What iterating does about a frame that cannot be read: ``"refuse"`` raises the DataError that names
            the file; ``"skip"`` logs it as a warning and continues. Asking for such a frame by index always raises.
    """

    def __init__(self, classes: Sequence[str], items: Sequence[Item], on_error: OnError) -> None:
        if on_error not in get_args(OnError):
            raise ConfigError(unknown_name("on_error choice", on_error, get_args(OnError)))
        self._classes = tuple(classes)
        self._items = items
        self._skip = on_error == "skip"

    @property
    def classes(self) -> tuple[str, ...]:
        """Class names in a fixed order."""
        return self._classes

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, index: int) -> Sample:
        if not -len(self._items) <= index < len(self._items):
            raise IndexError(f"frame {index} of {len(self._items)}")
        return self._read(self._items[index])

    def __iter__(self) -> Iterator[Sample]:
        for item in self._items:
            try:
                sample = self._read(item)
            except DataError as error:
                if not self._skip:
                    raise
                logger.warning("left out: %s", error)
                continue
            yield sample

    @abstractmethod
    def _read(self, item: Item) -> Sample:
        """Read one frame; raises DataError naming the file that is at fault."""
