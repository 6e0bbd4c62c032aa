"""Checks of samples and targets that all heads share."""

from __future__ import annotations

import torch

from icub_core.errors import DataError


def check_samples(X: torch.Tensor, expected_dim: int | None = None, *, who: str) -> None:
    """Raise DataError unless X is (n, d) floating point, finite, n >= 1 and, when given, d is `expected_dim`."""
    if X.ndim != 2 or not X.is_floating_point():
        raise DataError(f"{who}: X is {tuple(X.shape)} {X.dtype}; expected (n, d) floating point")
    if expected_dim is not None and X.shape[1] != expected_dim:
        raise DataError(f"{who}: X has {X.shape[1]} features a sample; expected {expected_dim}, as when fitted")
    # a sum is finite only where all its terms are, and costs a tenth of looking at each
    if not bool(torch.isfinite(X.sum())) and not bool(torch.isfinite(X).all()):
        rows = torch.nonzero(~torch.isfinite(X).all(dim=1)).flatten()
        raise DataError(f"{who}: X is not finite in {len(rows)} of {len(X)} samples, first in sample {int(rows[0])}")


def check_training_set(
    X: torch.Tensor, Y: torch.Tensor, sample_weight: torch.Tensor | None = None, *, who: str
) -> None:
    """Raise DataError unless X (n, d), Y (n, t) and the weights (n,) fit together, are finite and not empty."""
    check_samples(X, who=who)
    if len(X) == 0:
        raise DataError(f"{who}: no samples; expected at least one")
    if Y.ndim != 2 or len(Y) != len(X) or Y.shape[1] == 0:
        raise DataError(f"{who}: Y is {tuple(Y.shape)}; expected ({len(X)}, t) with t >= 1 problems")
    if not bool(torch.isfinite(Y).all()):
        raise DataError(f"{who}: Y is not finite; expected +1 and -1, or real targets")
    if sample_weight is None:
        return
    if sample_weight.shape != (len(X),):
        raise DataError(f"{who}: sample_weight is {tuple(sample_weight.shape)}; expected ({len(X)},)")
    if not bool(torch.isfinite(sample_weight).all()) or bool((sample_weight < 0).any()) or not sample_weight.sum() > 0:
        raise DataError(f"{who}: sample_weight must be finite, not negative and not all zero")
