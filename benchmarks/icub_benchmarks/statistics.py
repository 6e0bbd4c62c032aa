"""Comparison and union of the results of several evaluations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from icub_core.errors import ConfigError
from icub_core.rollouts import EpisodeResults


def paired_gain(
    better: EpisodeResults, base: EpisodeResults, *, resamples: int = 10_000, seed: int = 0
) -> tuple[float, tuple[float, float]]:
    """Return the difference of success rates over the same starts and its 95 % bootstrap interval (over episodes)."""
    if len(better) != len(base) or better.objects != base.objects:
        raise ConfigError("a paired comparison needs results of the same episodes")
    difference = better.success.astype(np.float64) - base.success
    draws = np.random.default_rng(seed).integers(len(difference), size=(resamples, len(difference)))
    low, high = np.quantile(difference[draws].mean(axis=1), [0.025, 0.975])
    return float(difference.mean()), (float(low), float(high))


def merge(results: Sequence[EpisodeResults]) -> EpisodeResults:
    """Put the results of several evaluations, such as one for each object, one after another."""
    return EpisodeResults(
        np.concatenate([r.success for r in results]),
        np.concatenate([r.returns for r in results]),
        np.concatenate([r.steps for r in results]),
        np.concatenate([r.reasons for r in results]),
        tuple(name for r in results for name in r.objects),
        results[0].reason_names,
        sum(r.faults for r in results),
        sum(r.resamples for r in results),
    )
