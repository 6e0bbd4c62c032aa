"""Contract of recorded episodes."""

from __future__ import annotations

import numpy as np

from icub_core.interfaces.episodes import Episode, Episodes, Step
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_raises, expect_same

MAX_EPISODES = 2
"""Episodes of a large set that are looked at: the first and the last."""


def _some(episodes: Episodes) -> list[Episode]:
    return [episodes[i] for i in sorted({0, len(episodes) - 1})[:MAX_EPISODES]]


def _sizes(step: Step) -> dict[str, tuple[int, ...]]:
    sizes = {"action": step.action.shape}
    for part in ("rgb", "depth", "state"):
        sizes |= {f"{part} '{name}'": values.shape for name, values in getattr(step, part).items()}
    return sizes


def check_length(make: Make) -> None:
    """There are episodes, each with steps; past either end IndexError is raised."""
    episodes = make()
    expect(len(episodes) > 0, "at least one episode", 0)
    expect_raises(IndexError, lambda: episodes[len(episodes)], "past the last episode")
    for episode in _some(episodes):
        expect(len(episode) > 0, f"at least one step of '{episode.task}'", 0)
        expect_raises(IndexError, lambda e=episode: e[len(e)], "past the last step")  # type: ignore[misc]


def check_words(make: Make) -> None:
    """Every episode names its task, and its instruction is text."""
    for episode in _some(make()):
        expect(isinstance(episode.task, str) and episode.task, "the name of a task", repr(episode.task))
        expect(isinstance(episode.instruction, str), "an instruction in words", type(episode.instruction).__name__)


def check_repeatable(make: Make) -> None:
    """A step is the same at every reading."""
    for episode in _some(make()):
        first, again = episode[0], episode[0]
        expect_same(first.action, again.action, "an action")
        for part in ("rgb", "depth", "state"):
            for name, value in getattr(first, part).items():
                expect_same(value, getattr(again, part)[name], f"{part} '{name}'")


def check_images(make: Make) -> None:
    """Color images are (H, W, 3) uint8; depth is (H, W) float32, meters, nowhere negative."""
    for episode in _some(make()):
        for camera, rgb in episode[0].rgb.items():
            expect(rgb.ndim == 3 and rgb.shape[2] == 3, f"an image (H, W, 3) of '{camera}'", rgb.shape)
            expect(rgb.dtype == np.uint8, f"an image of type uint8 of '{camera}'", rgb.dtype)
        for camera, depth in episode[0].depth.items():
            expect(depth.ndim == 2 and depth.dtype == np.float32, f"depth (H, W) float32 of '{camera}'", depth.dtype)
            expect(np.all(np.isfinite(depth) & (depth >= 0)), f"depth of 0 or more of '{camera}'", depth.min())


def check_numbers(make: Make) -> None:
    """States and actions are finite vectors of float64."""
    for episode in _some(make()):
        for step in episode:
            for name, values in {"action": step.action, **step.state}.items():
                fits = values.ndim == 1 and values.dtype == np.float64 and np.all(np.isfinite(values))
                expect(fits, f"a finite vector of float64 for '{name}'", (values.shape, values.dtype))


def check_sizes(make: Make) -> None:
    """Cameras, quantities and their sizes are the same in every step of an episode."""
    for episode in _some(make()):
        expect_same(_sizes(episode[0]), _sizes(episode[len(episode) - 1]), "sizes in the first and the last step")


def check_iteration(make: Make) -> None:
    """Iterating gives the episodes, and their steps, in order."""
    episodes = make()
    episode = next(iter(episodes))
    expect_same(episode.task, episodes[0].task, "the first episode, by iteration and by index")
    for i, step in enumerate(episode):
        expect_same(step.action, episode[i].action, f"step {i}, by iteration and by index")
