"""Exact uniform sampling of negatives, a fixed number per image, while images keep arriving (Algorithms 2 and 3).

A uniform sample without replacement of such a sample is uniform (thesis appendix D), so old images may be thinned out
again and again as new ones come. Here more holds: rows are chosen by the random priority that each got when it came,
the lowest first. Whatever was forgotten in between, the choice is that of a batch which saw all images at once, row
for row. The released code draws with replacement, for which neither holds.
"""

from __future__ import annotations

import torch

from icub_segmenters.region_store import BACKGROUND, RegionStore

MAX_NEAR = 5000
"""Positives and near misses of a class that are kept: more than its training uses."""


def quota_per_image(budget: int, images: int) -> int:
    """Return ceil(budget / images): how many negatives an image may keep. Source: thesis, Algorithms 1 to 3."""
    return -(-budget // max(images, 1))


def sample(rows: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    """Draw min(count, n) of the rows (n,), all subsets equally likely, in random order."""
    return rows[torch.randperm(len(rows), generator=generator)[:count]]


def sample_per_group(rows: torch.Tensor, group: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    """Draw min(count, size) of the rows (n,) of each group, uniformly and independently; group (n,) int64."""
    if len(rows) == 0:
        return rows
    order = torch.randperm(len(rows), generator=generator)
    by_group = order[torch.argsort(group[order], stable=True)]  # grouped, random within a group
    sorted_group = group[by_group]
    starts = torch.searchsorted(sorted_group, sorted_group)
    rank = torch.arange(len(rows)) - starts
    return rows[by_group[rank < count]]


def lowest_per_group(rows: torch.Tensor, group: torch.Tensor, priority: torch.Tensor, count: int) -> torch.Tensor:
    """Take the min(count, size) rows (n,) of lowest priority (n,) of each group; group (n,) int64."""
    by_priority = torch.argsort(priority)
    by_group = by_priority[torch.argsort(group[by_priority], stable=True)]
    sorted_group = group[by_group]
    rank = torch.arange(len(rows)) - torch.searchsorted(sorted_group, sorted_group)
    return rows[by_group[rank < count]]


def shared_negatives(store: RegionStore, budget: int, generator: torch.Generator) -> torch.Tensor:
    """Draw rows that overlap no instance of any class: at most `budget` of them, evenly over images, shuffled."""
    return sample(_of_images(store, store.near == BACKGROUND, budget), budget, generator)


def class_negatives(store: RegionStore, number: int, budget: int, generator: torch.Generator) -> torch.Tensor:
    """Draw the negatives of one class (Algorithm 3): at most `budget` rows, evenly over images, shuffled.

    In an image that shows the class these are regions away from its instances; in any other image they are regions of
    any kind, other classes' positives included. Both are the rows that are not near the class, so one table of regions
    serves as the algorithm's per-image negatives and as its buffer, for all classes at once.
    """
    return sample(_of_images(store, store.near != number, budget), budget, generator)


def later_negatives(store: RegionStore, first: int, budget: int, generator: torch.Generator) -> torch.Tensor:
    """Draw the common negatives of all classes from `first` on, as `class_negatives` does for one."""
    return sample(_of_images(store, store.near < first, budget), budget, generator)


def thin_out(store: RegionStore, budget: int) -> None:
    """Drop rows that no later training would choose; the samples of all `..._negatives` stay the same.

    An image keeps its share of background, of all its regions (the buffer of Algorithm 3), and of those away from each
    class that it shows; a class keeps MAX_NEAR positives and near misses.
    """
    n, near = len(store), store.near
    kept = torch.zeros(n, dtype=torch.bool)
    kept[_of_images(store, near == BACKGROUND, budget)] = True
    kept[_of_images(store, torch.ones(n, dtype=torch.bool), budget)] = True
    for c in near[near != BACKGROUND].unique().tolist():
        showing = torch.zeros(store.images, dtype=torch.bool)
        showing[store.image[near == c]] = True
        kept[_of_images(store, showing[store.image] & (near != c), budget)] = True
    rows = torch.nonzero(near != BACKGROUND).flatten()
    kept[lowest_per_group(rows, near[rows], store.priority[rows], MAX_NEAR)] = True
    store.keep(torch.nonzero(kept).flatten())


def _of_images(store: RegionStore, eligible: torch.Tensor, budget: int) -> torch.Tensor:
    """Choose ceil(budget / images) of the eligible (n,) bool rows of each image."""
    rows = torch.nonzero(eligible).flatten()
    return lowest_per_group(rows, store.image[rows], store.priority[rows], quota_per_image(budget, store.images))
