"""Success of a policy in a task, episode by episode, from starts that depend on nothing but the seed."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase

from icub_core.errors import ConfigError, PluginError
from icub_core.interfaces.policy import Policy, Progress
from icub_core.interfaces.task import RUNNING, Start, Task

StepRecorder = Callable[[int, Task, int, TensorDictBase], None]
"""Called after every step with world, task, episode number and what that world's step gave (observation,
`action`, `reward`, `reason`), to take images and to tell listeners."""

WILSON_Z = 1.959963984540054


@dataclass(frozen=True, eq=False)
class EpisodeResults:
    """What happened in every episode, ordered by episode number.

    Attributes:
        success: (E,) bool.
        returns: (E,) sums of rewards.
        steps: (E,) control steps.
        reasons: (E,) positions in `reason_names`.
        faults: Episodes that a fault ended; they count as failures.
        objects: Name of each episode's object.
        reason_names: Of the task.
        resamples: Starts that were impossible and drawn again.
    """

    success: NDArray[np.bool_]
    returns: NDArray[np.float64]
    steps: NDArray[np.int64]
    reasons: NDArray[np.int64]
    objects: tuple[str, ...]
    reason_names: tuple[str, ...] = ()
    faults: int = 0
    resamples: int = 0

    def __len__(self) -> int:
        return len(self.success)

    @property
    def success_rate(self) -> float:
        """Share of successful episodes."""
        return float(self.success.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the success rate."""
        return wilson_interval(int(self.success.sum()), len(self.success))

    def by_object(self) -> dict[str, tuple[int, int]]:
        """Return successes and episodes by object."""
        counts: dict[str, tuple[int, int]] = {}
        for name, success in zip(self.objects, self.success, strict=True):
            won, total = counts.get(name, (0, 0))
            counts[name] = (won + int(success), total + 1)
        return counts

    def ends(self) -> dict[str, int]:
        """Return the number of episodes by the name of their end."""
        return {self.reason_names[r]: n for r, n in sorted(Counter(self.reasons.tolist()).items())}


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a binomial share."""
    if trials == 0:
        return 0.0, 1.0
    share, z2 = successes / trials, WILSON_Z**2
    middle = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = WILSON_Z * np.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    return float(max(middle - half, 0.0)), float(min(middle + half, 1.0))


def evaluate(
    policy: Policy,
    task: Task,
    episodes: int = 20,
    seed: int = 0,
    *,
    recorder: StepRecorder | None = None,
    progress: Progress | None = None,
    first: int = 0,
) -> EpisodeResults:
    """Run a policy deterministically for a number of episodes.

    Episode e starts from the generator seeded with (seed, e), in world e mod N: two policies that are evaluated with
    one seed in one task meet the same starts, whatever they do in between.

    Args:
        policy: Acts.
        task: Its worlds are taken over; call `reset` before using it for anything else.
        episodes: How many.
        seed: Of the starts.
        recorder: Sees every step.
        progress: Told about finished episodes.
        first: Number of the first episode, for an evaluation done in parts.
    """
    if episodes < 1:
        raise ConfigError(f"evaluation of {episodes} episodes; expected at least 1")

    def start_of(world: int, episode: int) -> Start:
        return task.draw(world, np.random.default_rng([seed, first + episode]))

    before = task.resamples
    results = run_episodes(policy, task, episodes, start_of, recorder=recorder, progress=progress)
    return replace(results, resamples=task.resamples - before)


def run_episodes(
    policy: Policy,
    task: Task,
    episodes: int,
    start_of: Callable[[int, int], Start],
    *,
    recorder: StepRecorder | None = None,
    progress: Progress | None = None,
) -> EpisodeResults:
    """Run episodes whose starts `start_of(world, episode)` gives; episode e runs in world e mod N."""
    policy.bind(task)
    worlds = task.batch_size[0]
    success = np.zeros(episodes, dtype=np.bool_)
    returns = np.zeros(episodes)
    steps = np.zeros(episodes, dtype=np.int64)
    reasons = np.zeros(episodes, dtype=np.int64)
    names = [""] * episodes
    queues = [list(range(world, episodes, worlds))[::-1] for world in range(worlds)]
    faults = 0

    def next_episode(world: int) -> int | None:
        if not queues[world]:
            return None
        episode = queues[world].pop()
        start = start_of(world, episode)
        task.begin(world, start)
        names[episode] = start.target
        return episode

    running = [next_episode(world) for world in range(worlds)]
    observation = task.observe()
    finished = 0
    while any(episode is not None for episode in running):
        action = observation["action"] = _act(policy, observation)
        observation = task.advance(observation, [episode is not None for episode in running])
        observation["action"] = action
        reward = observation["reward"].reshape(-1).numpy()
        reason = observation["reason"].reshape(-1).numpy()
        begun = False
        for world, episode in enumerate(running):
            if episode is None:
                continue
            returns[episode] += reward[world]
            steps[episode] += 1
            if recorder is not None:
                recorder(world, task, episode, observation[world])
            if reason[world] == RUNNING:
                continue
            success[episode] = bool(observation["success"][world])
            faults += int(observation["fault"][world])
            reasons[episode] = reason[world]
            finished += 1
            running[world] = next_episode(world)
            begun = True
            if progress is not None:
                progress(finished / episodes, f"{int(success.sum())} of {finished} succeeded")
        if begun:
            observation = task.observe()
    return EpisodeResults(success, returns, steps, reasons, tuple(names), task.reasons, faults)


def _act(policy: Policy, observation: TensorDictBase) -> torch.Tensor:
    try:
        with torch.no_grad():
            return policy.act(observation)
    except KeyError as missing:
        known = ", ".join(sorted(str(key) for key in observation.keys()))
        named = re.search(r'"([^"]+)"', str(missing.args[0]))  # a TensorDict's message lists its keys too
        name = named[1] if named else missing.args[0]
        raise PluginError(
            f"the policy {type(policy).__name__} asks for the observation '{name}', which the task does not have (a "
            f"policy written for version 1 of the interface? this is version 2). Known: {known}"
        ) from missing
