"""Minibootstrap: hard negatives are found batch by batch while classifiers are trained (thesis Algorithm 1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch

from icub_core.errors import ConfigError
from icub_core.interfaces.abilities import SharesKernel
from icub_core.interfaces.online_head import OnlineHead

MakeHead = Callable[[], OnlineHead]


class Rows(Protocol):
    """Samples that are asked for by row numbers: a tensor, or a view that prepares rows when they are used."""

    def __getitem__(self, rows: torch.Tensor, /) -> torch.Tensor:
        """Return the samples (k, d) of row numbers (k,)."""


@dataclass(frozen=True)
class Minibootstrap:
    """The procedure's numbers.

    Attributes:
        batches: Number of batches of negatives (n_B).
        batch_size: Negatives per batch (BS).
        easy: Kept negatives that score below are dropped again.
        hard: Fresh negatives that score above are added.
    """

    batches: int = 10
    batch_size: int = 2000
    easy: float = -0.9
    hard: float = -0.7

    def __post_init__(self) -> None:
        if self.batches < 1 or self.batch_size < 1:
            raise ConfigError(
                f"Minibootstrap of {self.batches} batches of {self.batch_size}; expected at least 1 of each"
            )

    @property
    def budget(self) -> int:
        """Negatives seen in all (n_B x BS)."""
        return self.batches * self.batch_size

    def train_class(
        self, make_head: MakeHead, X: Rows, positives: torch.Tensor, negatives: torch.Tensor
    ) -> OnlineHead | None:
        """Train one class as the thesis does: own samples, own centers drawn anew in every round.

        Args:
            make_head: Gives an untrained head.
            X: (n, d) features of all regions, normalized.
            positives: (p,) row numbers.
            negatives: (q,) row numbers in random order; beyond the budget they are ignored.

        Returns:
            The head after the last round, or None without positives: such a class is never found.
        """
        if len(positives) == 0:
            return None
        head = make_head()
        first, *rest = negatives[: self.budget].split(self.batch_size) if len(negatives) else (negatives,)
        chosen = first
        _fit(head, X, positives, chosen)
        for batch in rest:
            chosen = chosen[_scores(head, X, chosen) >= self.easy]
            chosen = torch.cat([chosen, batch[_scores(head, X, batch) > self.hard]])
            _fit(head, X, positives, chosen)
        return head

    def train_shared(
        self, make_head: MakeHead, X: Rows, label: torch.Tensor, negatives: torch.Tensor, classes: int
    ) -> OnlineHead:
        """Train all classes at once on one pool of regions: a documented variation, much faster.

        Classes share samples, centers and the factorization; a region of one class is a negative of all others. A
        fresh negative is added when it is hard for any class. With a head that shares its kernel, such as FALKON, the
        centers are drawn once from the whole pool and every kernel row is computed once, for scoring and training
        alike; easy negatives, once added, stay: taking them out would cost as much as it saves.

        Args:
            make_head: Gives an untrained head.
            X: (n, d) features of all regions, normalized.
            label: (n,) class number, -1 for background.
            negatives: (q,) row numbers of background regions in random order.
            classes: Number of classes (t); one without positives scores every region about -1.
        """
        positives = torch.nonzero(label >= 0).flatten()
        first, *rest = negatives[: self.budget].split(self.batch_size) if len(negatives) else (negatives,)
        head = make_head()
        start = torch.cat([positives, first])
        Y = one_vs_rest(label, classes)
        if isinstance(head, SharesKernel):
            self._train_on_one_kernel(head, X, Y, start, rest)
            return head
        chosen = start
        head.fit(X[chosen], Y[chosen])
        for batch in rest:
            hard = (head.decision_function(X[batch]) > self.hard).any(dim=1)
            if bool(hard.any()):
                chosen = torch.cat([chosen, batch[hard]])
                head.fit(X[chosen], Y[chosen])
        return head

    def _train_on_one_kernel(
        self, head: SharesKernel, X: Rows, Y: torch.Tensor, start: torch.Tensor, rest: list[torch.Tensor]
    ) -> None:
        pool = torch.cat([start, *rest])
        system = head.kernel_system(X[pool[head.choose_centers(Y[pool])]], Y.shape[1])
        system.add(X[start], Y[start])
        for batch in rest:
            rows = system.rows(X[batch])
            hard = (system.scores(rows) > self.hard).any(dim=1)
            if bool(hard.any()):
                system.add_rows(rows[hard], Y[batch][hard.cpu()])
        head.adopt(system)


def one_vs_rest(label: torch.Tensor, classes: int) -> torch.Tensor:
    """Turn class numbers (n,), -1 for none, into targets (n, classes) of +1 and -1."""
    return torch.where(label[:, None] == torch.arange(classes), 1.0, -1.0)


def _fit(head: OnlineHead, X: Rows, positives: torch.Tensor, negatives: torch.Tensor) -> None:
    Y = torch.cat([torch.ones(len(positives), 1), -torch.ones(len(negatives), 1)])
    head.fit(X[torch.cat([positives, negatives])], Y)


def _scores(head: OnlineHead, X: Rows, rows: torch.Tensor) -> torch.Tensor:
    return head.decision_function(X[rows]).squeeze(1)
