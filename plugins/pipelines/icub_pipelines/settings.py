"""Settings of the pipelines' stages; their fields are keys of the group `pipeline`."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from icub_core.bounds import at_least


@dataclass(frozen=True)
class TeachSettings:
    """What is taught to the robot.

    Attributes:
        objects: Names from the object set, in the order of teaching; None teaches `preferred`, or the first five of a
            set that has not all of them.
        preferred: See `objects`.
        frames: Images of each.
    """

    objects: list[str] | None = None
    preferred: tuple[str, ...] = ()
    frames: Annotated[int, at_least(1)] = 60


@dataclass(frozen=True)
class SeeSettings:
    """How the segmenter is evaluated.

    Attributes:
        frames: Test images.
        distractors: Objects on the table that are never taught, drawn from the rest of the object set and from
            `distractor_set`.
        distractor_set: Object set that is in no training set; None takes the rest of the object set alone.
        strangers: Old name of `distractors`, for one release.
    """

    frames: Annotated[int, at_least(1)] = 50
    distractors: Annotated[int, at_least(0)] = 12
    distractor_set: str | None = None
    strangers: Annotated[int | None, at_least(0)] = None

    @property
    def count(self) -> int:
        """Number of distractors, by whichever name it was given."""
        if self.strangers is None:
            return self.distractors
        warnings.warn("pipeline.see.strangers is now pipeline.see.distractors", DeprecationWarning, stacklevel=2)
        return self.strangers


@dataclass(frozen=True)
class GraspSettings:
    """The grasping stage.

    Attributes:
        target: Object to grasp, from the object set; None is `preferred` where it is taught (or, without a
            segmenter, in the set), else the first one.
        preferred: See `target`.
        episodes: Evaluation episodes after learning.
        video_episodes: The last of them that are recorded.
        worlds: Simulated worlds side by side.
        starts: Planned starts that each world keeps while a policy learns; evaluation always plans afresh.
        threads: Threads that step physics.
        visual: Let policies see the head camera's image, as the chosen feature extractor describes it.
    """

    target: str | None = None
    preferred: str | None = None
    episodes: Annotated[int, at_least(1)] = 20
    video_episodes: Annotated[int, at_least(0)] = 3
    worlds: Annotated[int, at_least(1)] = 8
    starts: Annotated[int, at_least(0)] = 24
    threads: Annotated[int, at_least(1)] = 2
    visual: bool = False


def taught_names(chosen: Sequence[str] | None, preferred: Sequence[str], known: Sequence[str], count: int) -> list[str]:
    """Return the objects to teach: the user's choice, else the preferred where all are known, else the first ones."""
    if chosen is not None:
        return list(chosen)
    return list(preferred[:count] if preferred and set(preferred[:count]) <= set(known) else known[:count])


def target_name(chosen: str | None, preferred: str | None, known: Sequence[str]) -> str:
    """Return the object to grasp: the user's choice, else the preferred one where it is known, else the first."""
    if chosen is not None:
        return chosen
    return preferred if preferred is not None and preferred in known else known[0]
