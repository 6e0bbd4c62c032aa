"""Incremental classes: only the classifiers of new classes are trained, the others stay as they are.

The thesis trains all classes again when one comes (11.8.1), because an old class may take the new object for its own.
Here old classes yield to the new one in regions that it claims with more right, and move nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.minibootstrap import MakeHead, Minibootstrap, Rows

CLAIMED = 0.0
"""A region belongs to a new class if it scores above this: 0 is undecided."""


@dataclass(frozen=True, eq=False)
class Addition:
    """Classes that came later, and together.

    Attributes:
        number: The first of them.
        head: Their classifier, a column a class.
    """

    number: int
    head: OnlineHead

    def apply(self, scores: torch.Tensor, X: torch.Tensor) -> None:
        """Write the scores of X (n, d) into `scores` (n, classes), and lower those of older classes there.

        Where a new class is positive and above an older one, that one's score falls to minus the new one's.
        """
        for number, own in enumerate(self.head.decision_function(X).split(1, dim=1), self.number):
            older = scores[:, :number]
            claimed = (own > CLAIMED) & (own > older)
            scores[:, :number] = torch.where(claimed, torch.minimum(older, -own), older)
            scores[:, number] = own[:, 0]


def add_class(
    number: int,
    minibootstrap: Minibootstrap,
    make_head: MakeHead,
    X: Rows,
    label: torch.Tensor,
    negatives: torch.Tensor,
) -> Addition | None:
    """Train one more class by Algorithms 1 and 3 to the letter.

    Args:
        number: The new class; old ones have lower numbers.
        minibootstrap: Numbers of the Minibootstrap.
        make_head: Gives an untrained head.
        X: (n, d) features of all regions, in the scale of the old classes.
        label: (n,) classes of the regions, -1 for none.
        negatives: (q,) row numbers of the new class's negatives, in random order.

    Returns:
        The addition, or None without positives: such a class is never found.
    """
    positives = torch.nonzero(label == number).flatten()
    head = minibootstrap.train_class(make_head, X, positives, negatives)
    return None if head is None else Addition(number, head)


def add_together(
    number: int,
    count: int,
    minibootstrap: Minibootstrap,
    make_head: MakeHead,
    X: Rows,
    label: torch.Tensor,
    negatives: torch.Tensor,
) -> Addition:
    """Train `count` more classes, the first of them `number`, on one pool, as `Minibootstrap.train_shared`.

    For one class this is Algorithm 1 with centers that stay, so that every kernel row is computed once: a third of the
    time. Other arguments as for `add_class`; `negatives` are away from all the new classes.
    """
    fresh = torch.where(label >= number, label - number, -1)
    return Addition(number, minibootstrap.train_shared(make_head, X, fresh, negatives, count))
