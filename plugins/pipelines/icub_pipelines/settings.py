"""Settings of the main pipeline, typed; the group `pipeline` of the configuration is checked against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

SHOWN = ("004_sugar_box", "005_tomato_soup_can", "006_mustard_bottle", "010_potted_meat_can", "021_bleach_cleanser")
"""What the main job shows of `ycb_primitives`."""
TARGET = "006_mustard_bottle"
"""What it grasps of them."""


@dataclass
class TeachSettings:
    """What is shown to the robot.

    Attributes:
        objects: Names from the object set, in the order of showing; None shows `SHOWN`, or the first five of a set
            that has not all of them.
        frames: Images of each.
    """

    objects: list[str] | None = None
    frames: int = 60


@dataclass
class SeeSettings:
    """The examination.

    Attributes:
        frames: Test images.
        distractors: Objects that are never taught but stand about, drawn from the object set and `random1000`.
    """

    frames: int = 50
    distractors: int = 12


@dataclass
class GraspSettings:
    """The grasping stage.

    Attributes:
        target: Object to grasp, from the object set; None is `TARGET` where it is taught (or, without a segmenter,
            in the set), else the first one.
        episodes: Evaluation episodes after learning.
        video_episodes: The last of them that are recorded.
        worlds: Simulated worlds side by side.
        starts: Planned starts that each world keeps while a policy learns; evaluation always plans afresh.
        threads: Threads that step physics.
        visual: Let policies see the head camera's image, as the chosen feature extractor describes it.
    """

    target: str | None = None
    episodes: int = 20
    video_episodes: int = 3
    worlds: int = 8
    starts: int = 24
    threads: int = 2
    visual: bool = False


@dataclass
class MainSettings:
    """Stages of the main job."""

    name: str = "main"
    teach: TeachSettings = field(default_factory=TeachSettings)
    see: SeeSettings = field(default_factory=SeeSettings)
    grasp: GraspSettings = field(default_factory=GraspSettings)


@dataclass
class ShowingSettings:
    """Teaching by showing: objects one after another, then the correction of a false positive.

    Attributes:
        objects: Shown in this order; what is learned of one is there before the next is shown. None shows the first
            three of `SHOWN`, or of a set that has not all of them.
        frames: Images of each.
        looks: Images of the table in which false positives are sought, and as many others that measure the change.
        distractors: Objects that stand about unknown; one of them is mistaken, and then taught.
        interactive: Take commands from the terminal instead of following the script.
    """

    name: str = "teach_by_showing"
    objects: list[str] | None = None
    frames: int = 60
    looks: int = 24
    distractors: int = 10
    interactive: bool = False


def shown(chosen: list[str] | None, known: Sequence[str], count: int = len(SHOWN)) -> list[str]:
    """Return the objects to show: the user's choice, else the usual ones where all are known, else the first ones."""
    if chosen is not None:
        return chosen
    return list(SHOWN[:count] if set(SHOWN[:count]) <= set(known) else known[:count])


def grasped(chosen: str | None, known: Sequence[str]) -> str:
    """Return the object to grasp: the user's choice, else the usual one where it is known, else the first."""
    if chosen is not None:
        return chosen
    return TARGET if TARGET in known else known[0]
