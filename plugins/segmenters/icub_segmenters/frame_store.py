"""Annotated frames, kept by segmenters that train on them in several epochs."""

from __future__ import annotations

from collections.abc import Sequence

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import NotFittedError
from icub_segmenters.training_image import check_masks


class FrameStore:
    """Frames with their instances, in the order in which they came, and the labels in the order of first sight.

    Attributes:
        frames: What was added.
        labels: Class names.
    """

    def __init__(self, labels: Sequence[str] = ()) -> None:
        """Start without frames; `labels` are known already."""
        self.frames: list[tuple[RgbdFrame, tuple[Instance, ...]]] = []
        self.labels = list(labels)

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, frame: RgbdFrame, instances: Sequence[Instance]) -> None:
        """Keep one annotated frame.

        Raises:
            DataError: A mask is empty or has another size than the image; nothing is kept of the frame.
        """
        check_masks(frame, instances)
        self.frames.append((frame, tuple(instances)))
        for instance in instances:
            if instance.label not in self.labels:
                self.labels.append(instance.label)

    def forget(self, number: int) -> None:
        """Drop a frame, and labels that only it showed."""
        _, dropped = self.frames.pop(number)
        shown = {i.label for _, instances in self.frames for i in instances}
        gone = {i.label for i in dropped} - shown
        self.labels = [label for label in self.labels if label not in gone]

    def counts(self) -> dict[str, int]:
        """Return the number of instances by label; raises NotFittedError when there is none at all."""
        counts = dict.fromkeys(self.labels, 0)
        for _, instances in self.frames:
            for instance in instances:
                counts[instance.label] += 1
        if not any(counts.values()):
            raise NotFittedError("there is nothing to learn: observe at least one frame with an instance first")
        return counts
