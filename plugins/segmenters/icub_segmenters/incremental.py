"""A class that is taught after others: only its own classifier is trained, the others stay as they are.

The thesis trains all classes again when one comes (11.8.1), because an old class may take the new object for its own.
Here old classes yield to the new one in regions that it claims with more right, and move nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.minibootstrap import MakeHead, Minibootstrap

CLAIMED = 0.0
"""A region belongs to the new class if it scores above this: 0 is undecided."""


@dataclass(frozen=True, eq=False)
class Addition:
    """One class that came later.

    Attributes:
        number: The class.
        head: Its classifier.
    """

    number: int
    head: OnlineHead

    def apply(self, scores: torch.Tensor, X: torch.Tensor) -> None:
        """Write the new class's scores of X (n, d) to its column of `scores` (n, classes); older ones yield, in place.

        Where the new class is positive and above an older one, that one's score falls to minus the new one's.
        """
        own = self.head.decision_function(X)
        older = scores[:, : self.number]
        claimed = (own > CLAIMED) & (own > older)
        scores[:, : self.number] = torch.where(claimed, torch.minimum(older, -own), older)
        scores[:, self.number] = own[:, 0]


def add_class(
    number: int,
    procedure: Minibootstrap,
    make_head: MakeHead,
    X: torch.Tensor,
    label: torch.Tensor,
    negatives: torch.Tensor,
) -> Addition | None:
    """Train one more class by the Minibootstrap (Algorithms 1 and 3).

    Args:
        number: The new class; old ones have lower numbers.
        procedure: Numbers of the Minibootstrap.
        make_head: Gives an untrained head.
        X: (n, d) features of all regions, in the scale of the old classes.
        label: (n,) classes of the regions, -1 for none.
        negatives: (q,) row numbers of the new class's negatives, in random order.

    Returns:
        The addition, or None without positives: such a class is never found.
    """
    positives = torch.nonzero(label == number).flatten()
    head = procedure.train_class(make_head, X, positives, negatives)
    return None if head is None else Addition(number, head)
