"""Incremental teaching of a segmenter, and its evaluation on cluttered tables."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from icub_core.data import Instance, RgbdFrame
from icub_core.interfaces.segmenter import Segmenter, UpdateReport
from icub_core.interfaces.simulator import Simulator
from icub_core.robot_description import RobotDescription
from icub_core.run import Run
from icub_core.scene import ObjectSpec
from icub_pipelines import seeing
from icub_pipelines.images import Image
from icub_pipelines.tabletop import Tabletop, tabletop_images
from icub_support.overlap import mask_iou

SAME_OBJECT_IOU = 0.5
"""A found mask that overlaps a true one by less is not about that object (the metric's lower threshold)."""

Look = tuple[RgbdFrame, tuple[Instance, ...]]
"""An image and the true instances of everything in it."""


@dataclass(frozen=True)
class Mistake:
    """An object that was called by another's name."""

    shown: str
    taken_for: str
    score: float


@dataclass
class TeachingSession:
    """A simulator that draws, a robot whose camera sees, and a segmenter that learns."""

    run: Run
    simulator: Simulator
    robot: RobotDescription
    segmenter: Segmenter

    @property
    def heads(self) -> Path:
        """Folder of the run in which what was learned is kept."""
        return self.run.run_dir / "segmenter"

    def teach(
        self, spec: ObjectSpec, frames: int, rng: np.random.Generator, number: int = 0, count: int = 1
    ) -> tuple[UpdateReport, Image, float]:
        """Show one object, the `number`-th of `count`, and learn it at once.

        Returns:
            The report of the update, an image with the mask that was learned from, and seconds in all.
        """
        started = time.perf_counter()
        _, sample = seeing.teach_object(
            self.simulator, self.robot, spec, self.segmenter, frames, rng,
            lambda share, text: self.run.progress((number + 0.95 * share) / count, text),
        )  # fmt: skip
        report = self.segmenter.update()
        return report, sample, time.perf_counter() - started

    def look(
        self, known: Sequence[ObjectSpec], unknown: Sequence[ObjectSpec], tabletop: Tabletop, rng: np.random.Generator
    ) -> list[Look]:
        """Look at tables with known and unknown objects on them, in other rooms than the training images'."""
        looks = []
        for number, image in enumerate(tabletop_images(self.simulator, known, unknown, tabletop, rng)):
            looks.append(image)
            self.run.progress((number + 1) / tabletop.frames, f"{number + 1} of {tabletop.frames} images")
        return looks

    def recognize(self, looks: Sequence[Look]) -> list[tuple[Instance, ...]]:
        """Return what the segmenter finds in each image, whatever its score."""
        found = []
        for number, (frame, _) in enumerate(looks):
            found.append(self.segmenter.segment(frame))
            self.run.progress((number + 1) / len(looks), f"{number + 1} of {len(looks)} images recognized")
        return found


def identities(found: Sequence[Instance], truth: Sequence[Instance]) -> list[tuple[Instance, str | None]]:
    """Return what a user is shown of an image, each with the name of the object that is truly there.

    What is shown is the best instance of a class, where its score is above 0.

    Args:
        found: By the segmenter.
        truth: Of all objects in the image.

    Returns:
        Instances and names; None where no single object is there.
    """
    shown = seeing.confident(found)
    overlaps = mask_iou([instance.mask for instance in shown], [instance.mask for instance in truth])
    return [
        (instance, truth[int(overlap.argmax())].label if len(truth) and overlap.max() >= SAME_OBJECT_IOU else None)
        for instance, overlap in zip(shown, overlaps, strict=True)
    ]


def mistakes(found: Sequence[Instance], truth: Sequence[Instance]) -> list[Mistake]:
    """Return the objects of an image that were called by another's name; arguments as of `identities`."""
    return [
        Mistake(name, instance.label, instance.score)
        for instance, name in identities(found, truth)
        if name is not None and name != instance.label
    ]


def recognized(found: Sequence[Instance], truth: Sequence[Instance], name: str) -> bool | None:
    """Return True if a user would be shown object `name` where it is; None when it is not in the image."""
    there = [instance.mask for instance in truth if instance.label == name]
    if not there:
        return None
    answers = [instance.mask for instance in seeing.confident(found) if instance.label == name]
    return bool((mask_iou(answers, there) >= SAME_OBJECT_IOU).any())
