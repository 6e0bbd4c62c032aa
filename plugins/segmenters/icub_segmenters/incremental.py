"""A class that is taught after others: only its own classifier is trained, the others stay as they are.

The thesis trains all classes again when one comes (11.8.1), because an old class may take the new object for its own.
Here only that mistake is mended: where an old class finds the new object, a correction is learnt together with the new
class, on the same samples and with the same factorisation. Its targets are what is missing to -1 on the new object and
0 on the old class's own positives and on the hard negatives, so an old class that makes no such mistake does not move
at all, and one that does moves where the new object is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.heads.rls import Rls
from icub_segmenters.minibootstrap import MakeHead, Minibootstrap
from icub_segmenters.sampling import sample

TAKEN_FOR = 0.0
"""An old class that scores above this on the new object would be reported in its place: 0 is undecided."""
PROTECTED = 500
"""Positives of a corrected class on which the correction learns to be 0."""

Scores = Callable[[torch.Tensor], torch.Tensor]


@dataclass(frozen=True, eq=False)
class Addition:
    """One class that came later.

    Attributes:
        number: The class.
        head: Its score in column 0; in the others what is added to the scores of `corrected`.
        corrected: Old classes that had taken the new object for theirs.
    """

    number: int
    head: OnlineHead
    corrected: tuple[int, ...] = ()

    def apply(self, scores: torch.Tensor, X: torch.Tensor) -> None:
        """Write the new class's scores of X (n, d) to its column of `scores` (n, classes) and correct the others'."""
        own = self.head.decision_function(X)
        scores[:, self.number] = own[:, 0]
        for column, c in enumerate(self.corrected, start=1):
            scores[:, c] += own[:, column]


def add_class(
    number: int,
    procedure: Minibootstrap,
    make_head: MakeHead,
    X: torch.Tensor,
    label: torch.Tensor,
    negatives: torch.Tensor,
    old_scores: Scores,
    generator: torch.Generator,
) -> Addition | None:
    """Train one more class by the Minibootstrap (Algorithms 1 and 3) and the corrections of old ones.

    Args:
        number: The new class; old ones have lower numbers.
        procedure: Numbers of the Minibootstrap.
        make_head: Gives an untrained head. Corrections need one that regresses (falkon, rls); with others old
            classes are left alone.
        X: (n, d) features of all regions, in the scale of the old classes.
        label: (n,) classes of the regions, -1 for none.
        negatives: (q,) row numbers of the new class's negatives, in random order.
        old_scores: Gives the scores (m, number) of the old classes for features (m, d).
        generator: Decides which positives of corrected classes are looked at.

    Returns:
        The addition, or None without positives: such a class is never found.
    """
    positives = torch.nonzero(label == number).flatten()
    head, hard = procedure.train_class_and_keep(make_head, X, positives, negatives)
    if head is None:
        return None
    taken = old_scores(X[positives])
    mistaken = torch.nonzero((taken > TAKEN_FOR).any(dim=0)).flatten().tolist() if taken.shape[1] else []
    if not mistaken or not isinstance(head, Falkon | Rls):
        return Addition(number, head)
    own = [sample(torch.nonzero(label == c).flatten(), PROTECTED, generator) for c in mistaken]
    others = torch.cat([hard, *own]).unique()
    rows = torch.cat([positives, others])
    Y = torch.zeros(len(rows), 1 + len(mistaken))
    Y[:, 0] = -1.0
    Y[: len(positives), 0] = 1.0
    excess = -1.0 - taken[:, mistaken]
    # what is no hard negative of the old class needs no correction either
    Y[: len(positives), 1:] = torch.where(taken[:, mistaken] > procedure.hard, excess, 0.0)
    head = make_head()
    head.fit(X[rows], Y)
    return Addition(number, head, tuple(mistaken))
