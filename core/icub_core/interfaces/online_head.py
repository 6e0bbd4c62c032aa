"""On-line head: a classifier or regressor that is trained in seconds on features computed before."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal

import torch

Score = Literal["estimate", "log_odds"]
"""What a score means: an estimate of the targets +1 and -1, or the logarithm of p / (1 - p) of a positive."""


class OnlineHead(ABC):
    """Real-valued scores for one or several one-vs-rest problems on one pool of samples.

    Contract: `fit` forgets what was fitted before; the same data and seed give the same scores; predicting before
    fitting raises NotFittedError; inputs are never changed; NaN or infinite features raise DataError; a head that was
    given the `state_dict` of another one of the same configuration gives the same scores.
    """

    @property
    def score(self) -> Score:
        """What the numbers of `decision_function` mean; 0 is undecided in both cases."""
        return "estimate"

    @abstractmethod
    def fit(self, X: torch.Tensor, Y: torch.Tensor, sample_weight: torch.Tensor | None = None) -> None:
        """Train on samples X (n, d) float32 with targets Y (n, t), usually +1 and -1, one column per problem."""

    @abstractmethod
    def decision_function(self, X: torch.Tensor) -> torch.Tensor:
        """Return scores (n, t) of samples X (n, d); their meaning is that of `score`."""

    @abstractmethod
    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return every tensor that decides the scores, by name. Raises NotFittedError before `fit`."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Load what `state_dict` returned. CheckpointError, and no change, when names or shapes differ."""


def probabilities(scores: torch.Tensor, meaning: Score) -> torch.Tensor:
    """Map scores of a meaning to 0..1, undecided to 0.5; estimates beyond the targets +1 and -1 are clipped."""
    return scores.sigmoid() if meaning == "log_odds" else (0.5 + 0.5 * scores).clamp(0, 1)
