"""On-line head: a classifier or regressor that is trained in a moment on features."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch


class OnlineHead(ABC):
    """Real-valued scores for one or several one-vs-rest problems on one pool of samples.

    Contract: `fit` forgets what was fitted before; the same data and seed give the same scores; predicting before
    fitting raises NotFittedError; inputs are never changed; NaN or infinite features raise DataError; a head that was
    given the `state_dict` of another one of the same configuration gives the same scores.
    """

    @abstractmethod
    def fit(self, X: torch.Tensor, Y: torch.Tensor, sample_weight: torch.Tensor | None = None) -> None:
        """Train on samples X (n, d) float32 with targets Y (n, t), usually +1 and -1, one column per problem."""

    @abstractmethod
    def decision_function(self, X: torch.Tensor) -> torch.Tensor:
        """Scores (n, t) of samples X (n, d)."""

    @abstractmethod
    def state_dict(self) -> dict[str, torch.Tensor]:
        """Every tensor that decides the scores, by name. Raises NotFittedError before `fit`."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Take over what `state_dict` gave. CheckpointError, and no change, when names or shapes differ."""
