"""Contract of data sets."""

from __future__ import annotations

from typing import Any

import numpy as np

from icub_core.config.schema import signature
from icub_core.interfaces.abilities import Closable
from icub_core.interfaces.dataset import Dataset
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_raises, expect_same

MAX_ITEMS = 4
"""Items of a large set that are looked at, spread over the whole set."""
BOX_MARGIN = 2.0
"""Pixels by which a box may differ from its mask's tight box, for annotations drawn by hand."""


def _some(dataset: Dataset) -> list[int]:
    return sorted({int(i) for i in np.linspace(0, len(dataset) - 1, min(MAX_ITEMS, len(dataset)))})


def check_classes(make: Make) -> None:
    """Classes have names, each once."""
    classes = make().classes
    expect(len(classes) > 0 and all(isinstance(c, str) and c for c in classes), "names of classes", classes)
    expect(len(set(classes)) == len(classes), "every class once", "a class twice")


def check_length(make: Make) -> None:
    """There are items; past the end IndexError is raised."""
    dataset = make()
    expect(len(dataset) > 0, "at least one item", 0)
    expect_raises(IndexError, lambda: dataset[len(dataset)], "past the end")


def check_splits(make: Make) -> None:
    """Splits have names, each once, and the constructor takes one of them where there are several."""
    dataset = make()
    splits = dataset.splits
    expect(len(splits) > 0 and all(isinstance(s, str) and s for s in splits), "names of splits", splits)
    expect(len(set(splits)) == len(splits), "every split once", splits)
    if len(splits) > 1:
        cls: Any = type(dataset)
        parameters = signature("dataset", cls.__name__, cls).parameters
        expect("split" in parameters, "a constructor parameter 'split'", ", ".join(parameters) or "none")
        chosen = parameters["split"].default
        expect(chosen in splits or parameters["split"].required, "a default split that exists", repr(chosen))


def check_labels(make: Make) -> None:
    """Every instance is of one of the classes."""
    dataset = make()
    for i in _some(dataset):
        labels = {instance.label for instance in dataset[i][1]}
        expect(labels <= set(dataset.classes), f"known labels in item {i}", sorted(labels - set(dataset.classes)))


def check_repeatable(make: Make) -> None:
    """An item is the same at every reading."""
    dataset = make()
    for i in _some(dataset):
        (first, annotated), (second, again) = dataset[i], dataset[i]
        expect_same(first.rgb, second.rgb, f"the image of item {i}")
        expect_same(first.depth, second.depth, f"the depth of item {i}")
        expect_same([a.label for a in annotated], [a.label for a in again], f"the labels of item {i}")
        for one, other in zip(annotated, again, strict=True):
            expect_same(one.mask, other.mask, f"a mask of item {i}")


def check_masks(make: Make) -> None:
    """Masks have the image's size, and boxes agree with them."""
    dataset = make()
    for i in _some(dataset):
        frame, instances = dataset[i]
        for instance in instances:
            size = frame.rgb.shape[:2]
            expect(instance.mask.shape == size, f"masks of {size} in item {i}", instance.mask.shape)
            if not instance.mask.any():
                continue  # a box without a mask is an annotation too
            rows, columns = np.nonzero(instance.mask)
            tight = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], dtype=np.float64)
            off = float(np.abs(tight - instance.box).max())
            expect(off <= BOX_MARGIN, f"the box of '{instance.label}' around its mask in item {i}", f"{off:.1f} px off")


def check_close(make: Make) -> None:
    """A set that can be closed may be closed twice."""
    dataset = make()
    if isinstance(dataset, Closable):
        dataset.close()
        dataset.close()


def check_iteration(make: Make) -> None:
    """Iterating gives the items in order."""
    dataset = make()
    frame, _ = next(iter(dataset))
    expect_same(frame.rgb, dataset[0][0].rgb, "the first item, by iteration and by index")
