"""Object set: named objects to put on a table."""

from __future__ import annotations

from abc import ABC, abstractmethod

from icub_core.scene import ObjectSpec


class ObjectSet(ABC):
    """A collection of objects that are built when asked for.

    Contract: `names` is sorted-stable and not empty; `get` of a known name is deterministic and its spec carries that
    name; `get` of another name raises ConfigError with the nearest one.
    """

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Every object of the set, in a fixed order."""

    @abstractmethod
    def get(self, name: str) -> ObjectSpec:
        """Build one object."""
