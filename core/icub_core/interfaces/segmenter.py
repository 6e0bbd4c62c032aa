"""Segmenter: learns new objects from a stream of annotated frames and finds them again."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from icub_core.data import Instance, RgbdFrame


@dataclass(frozen=True)
class UpdateReport:
    """What training the heads took.

    Attributes:
        seconds: Wall time of the whole update.
        parts: Seconds by part, such as ``detection``, ``masks``.
        classes: Classes known after the update.
        samples: Number of positives by class.
    """

    seconds: float
    parts: dict[str, float] = field(default_factory=dict)
    classes: tuple[str, ...] = ()
    samples: dict[str, int] = field(default_factory=dict)


class Segmenter(ABC):
    """Learns in three steps: `observe` every frame, `update` when the last has come, then `segment`.

    Contract: `observe` after `update` adds to what is known (old classes are kept); `segment` before any `update`
    raises NotFittedError; labels are those that were taught; masks have the image's size; a frame without instances is
    a negative example; same frames and seed give the same result.
    """

    @abstractmethod
    def observe(self, frame: RgbdFrame, instances: Sequence[Instance]) -> None:
        """Extract the features of one annotated frame and keep them; nothing is trained."""

    @abstractmethod
    def update(self) -> UpdateReport:
        """Train the heads on everything observed so far."""

    @abstractmethod
    def segment(self, frame: RgbdFrame) -> tuple[Instance, ...]:
        """Find the taught objects, best score first."""

    @property
    @abstractmethod
    def classes(self) -> tuple[str, ...]:
        """Classes known since the last `update`."""

    @abstractmethod
    def save(self, path: Path) -> None:
        """Write the trained heads to a folder, without pickle, atomically."""

    @abstractmethod
    def load(self, path: Path) -> None:
        """Read what `save` wrote; CheckpointError for anything else, and the segmenter stays as it was."""
