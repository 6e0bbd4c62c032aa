"""A class that is taught after others: only its own classifier is trained, the others stay as they are.

The thesis trains all classes again when one comes (11.8.1), because an old class may take the new object for its own.
Here an old class that makes this mistake yields to the new one, where the new one claims a region with more right. An
old class that does not make it never moves at all, and one that does moves only where the new class sees its object.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.minibootstrap import MakeHead, Minibootstrap

TAKEN_FOR = 0.0
"""An old class that scores above this on the new object would be reported in its place: 0 is undecided."""

Scores = Callable[[torch.Tensor], torch.Tensor]


@dataclass(frozen=True, eq=False)
class Addition:
    """One class that came later.

    Attributes:
        number: The class.
        head: Its classifier.
        yielding: Old classes that had taken the new object for theirs.
    """

    number: int
    head: OnlineHead
    yielding: tuple[int, ...] = ()

    def apply(self, scores: torch.Tensor, X: torch.Tensor) -> None:
        """Write the new class's scores of X (n, d) to its column of `scores` (n, classes); others yield, in place.

        Where the new class is positive and above a yielding one, that one's score falls to minus the new one's.
        """
        own = self.head.decision_function(X).squeeze(1)
        scores[:, self.number] = own
        for c in self.yielding:
            claimed = (own > TAKEN_FOR) & (own > scores[:, c])
            scores[:, c] = torch.where(claimed, torch.minimum(scores[:, c], -own), scores[:, c])


def add_class(
    number: int,
    procedure: Minibootstrap,
    make_head: MakeHead,
    X: torch.Tensor,
    label: torch.Tensor,
    negatives: torch.Tensor,
    old_scores: Scores,
) -> Addition | None:
    """Train one more class by the Minibootstrap (Algorithms 1 and 3), and see which old ones have to yield.

    Args:
        number: The new class; old ones have lower numbers.
        procedure: Numbers of the Minibootstrap.
        make_head: Gives an untrained head.
        X: (n, d) features of all regions, in the scale of the old classes.
        label: (n,) classes of the regions, -1 for none.
        negatives: (q,) row numbers of the new class's negatives, in random order.
        old_scores: Gives the scores (m, number) of the old classes for features (m, d).

    Returns:
        The addition, or None without positives: such a class is never found.
    """
    positives = torch.nonzero(label == number).flatten()
    head = procedure.train_class(make_head, X, positives, negatives)
    if head is None:
        return None
    taken = (old_scores(X[positives]) > TAKEN_FOR).any(dim=0)
    return Addition(number, head, tuple(torch.nonzero(taken).flatten().tolist()))
