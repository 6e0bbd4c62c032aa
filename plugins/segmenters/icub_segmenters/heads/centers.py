"""Which samples become Nystrom centers."""

from __future__ import annotations

import torch

from icub_core.errors import ConfigError, unknown_name

SELECTIONS = ("uniform", "balanced")


def check_selection(name: str) -> None:
    """Raise ConfigError unless `name` is a way of choosing centers."""
    if name not in SELECTIONS:
        raise ConfigError(unknown_name("choice of centers", name, SELECTIONS))


def uniform_centers(n: int, count: int, generator: torch.Generator) -> torch.Tensor:
    """Return min(n, count) distinct indices in 0..n-1, all subsets equally likely, ascending."""
    if n <= count:
        return torch.arange(n)
    return torch.randperm(n, generator=generator)[:count].sort().values


def balanced_centers(Y: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    """Choose up to count x t / (t + 1) positives, evenly over the t problems, and fill up with negatives.

    Background counts as one more class. For one problem this is min(|P|, M / 2) positives and the rest negatives
    (thesis 5.3), drawn without replacement: the released code draws with replacement and so wastes centers on
    duplicates. Where negatives are too few, positives fill up.

    Args:
        Y: (n, t) targets; above 0 is positive.
        count: Centers wanted (M).
        generator: Decides the draw.

    Returns:
        (min(n, count),) distinct indices, ascending.
    """
    n, t = Y.shape
    if n <= count:
        return torch.arange(n)
    order = torch.randperm(n, generator=generator)
    positive = Y[order] > 0  # (n, t), in random order
    # a sample's turn is its rank among the positives of its problem: small classes are not crowded out by large ones
    turn = torch.where(positive, positive.cumsum(dim=0), n + 1).amin(dim=1)
    is_positive = positive.any(dim=1)
    positives = order[is_positive][torch.argsort(turn[is_positive], stable=True)]
    negatives = order[~is_positive]
    wanted_positives = max(min(len(positives), count * t // (t + 1)), count - len(negatives))
    chosen = torch.cat([positives[:wanted_positives], negatives[: count - wanted_positives]])
    return chosen.sort().values
