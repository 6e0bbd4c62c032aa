"""The numbers of the teaching procedure that ablations change, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Procedure:
    """How frames become samples and candidates become instances.

    Attributes:
        pixel_share: Share of a region's pixels that are kept, of the object's and of the others alike (the thesis's r).
        jittered_boxes: Boxes drawn around each true one: with the proposals they are the positives.
        distractor_boxes: Boxes described of each known other object: its own, and others drawn around it.
        look_alikes: Share of the pasted distractors that take on the taught object's colors.
        bank_images: Clutter images that are learned as they are before the first frame: a bank of negatives.
        vote_iou: Candidates of the same class that overlap a detection by more have a say in where it is; 1 for none.
        min_score: Instances that score less are not reported: between -0.7 and the targets of negatives, -1, all is
            noise.
    """

    pixel_share: float = 0.3
    jittered_boxes: int = 6
    distractor_boxes: int = 2
    look_alikes: float = 0.6
    bank_images: int = 0
    vote_iou: float = 0.6
    min_score: float = -0.7


STANDARD = Procedure()
"""The procedure that is used where no other is given."""
