"""Exact uniform sampling of negatives, a fixed number an image, while images keep arriving.

A uniform sample without replacement of a uniform sample without replacement is uniform (thesis appendix D), so old
images may be thinned out again and again as new ones come: the result is distributed as if all had been there from the
start (Algorithms 2 and 3). The released code draws with replacement, for which this does not hold.
"""

from __future__ import annotations

import torch

from icub_segmenters.region_store import BACKGROUND, RegionStore

MOST_NEAR = 5000
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


def shared_negatives(store: RegionStore, budget: int, generator: torch.Generator) -> torch.Tensor:
    """Draw rows that overlap no instance of any class: at most `budget` of them, evenly over images, shuffled."""
    rows = torch.nonzero(store.near == BACKGROUND).flatten()
    rows = sample_per_group(rows, store.image[rows], quota_per_image(budget, store.images), generator)
    return sample(rows, budget, generator)


def class_negatives(store: RegionStore, number: int, budget: int, generator: torch.Generator) -> torch.Tensor:
    """Draw the negatives of one class (Algorithm 3): at most `budget` rows, evenly over images, shuffled.

    In an image that shows the class these are regions away from its instances; in any other image they are regions of
    any kind, other classes' positives included. Both are the rows that are not near the class, so one table of regions
    serves as the algorithm's per-image negatives and as its buffer, for all classes at once.
    """
    rows = torch.nonzero(store.near != number).flatten()
    rows = sample_per_group(rows, store.image[rows], quota_per_image(budget, store.images), generator)
    return sample(rows, budget, generator)


def thin_out(store: RegionStore, budget: int, generator: torch.Generator) -> None:
    """Drop surplus rows, uniformly: an image keeps ceil(budget / images) background rows, a class MOST_NEAR others."""
    background = torch.nonzero(store.near == BACKGROUND).flatten()
    background = sample_per_group(background, store.image[background], quota_per_image(budget, store.images), generator)
    near = torch.nonzero(store.near != BACKGROUND).flatten()
    near = sample_per_group(near, store.near[near], MOST_NEAR, generator)
    store.keep(torch.cat([near, background]).sort().values)
