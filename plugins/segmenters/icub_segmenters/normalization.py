"""Normalization of features to a common scale, so that one kernel width suits all extractors."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from icub_core.errors import DataError

TARGET_NORM = 20.0
STATISTICS_SAMPLES = 4000
POSITIVE_SHARE = 0.8


@dataclass(frozen=True, eq=False)
class Normalization:
    """x <- (x - mean) * 20 / mean_norm.

    mean_norm is the mean length of the samples before centering. These are no z-scores, in spite of the name they have
    in the released code: directions keep their relative spread.

    Attributes:
        mean: (d,) float32.
        mean_norm: Above 0.
    """

    mean: torch.Tensor
    mean_norm: float

    def __call__(self, X: torch.Tensor) -> torch.Tensor:
        """Normalize features (..., d)."""
        return X.sub(self.mean.to(X)).mul_(TARGET_NORM / self.mean_norm)

    def rows_of(self, X: torch.Tensor) -> NormalizedRows:
        """Return a view of X (n, d) whose rows are normalized when they are asked for."""
        return NormalizedRows(self, X)

    @classmethod
    def of(cls, X: torch.Tensor) -> Normalization:
        """Measure samples X (n, d)."""
        if len(X) == 0:
            raise DataError("no samples to measure; expected at least one")
        return cls(X.mean(dim=0), max(float(X.norm(dim=1).mean()), 1e-12))

    @classmethod
    def of_classes(cls, X: torch.Tensor, label: torch.Tensor, generator: torch.Generator) -> Normalization:
        """Measure a sample of X (n, d) that is 80 % positives, evenly over the classes of label (n,) (-1: none).

        Without replacement, unlike the released code: a class of three samples gives three.
        """
        classes = [int(c) for c in label.unique() if c >= 0]
        quota = round(STATISTICS_SAMPLES * POSITIVE_SHARE / max(len(classes), 1))
        wanted = [(c, quota) for c in classes] + [(-1, round(STATISTICS_SAMPLES * (1 - POSITIVE_SHARE)))]
        rows = []
        for c, count in wanted:
            members = torch.nonzero(label == c).flatten()
            rows.append(members[torch.randperm(len(members), generator=generator)[:count]])
        return cls.of(X[torch.cat(rows)])


@dataclass(frozen=True, eq=False)
class NormalizedRows:
    """Features X (n, d) of which training uses few: only those are copied and normalized.

    Attributes:
        normalization: Their scale.
        X: (n, d) as they are kept.
    """

    normalization: Normalization
    X: torch.Tensor

    def __getitem__(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the normalized rows (k, d) of row numbers (k,)."""
        return self.normalization(self.X[rows])
