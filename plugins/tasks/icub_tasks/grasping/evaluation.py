"""Success of a policy, episode by episode, from starts that depend on nothing but the seed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase

from icub_core.errors import ConfigError
from icub_core.interfaces.policy import Policy, Progress
from icub_tasks.grasping.env import GraspEnv
from icub_tasks.grasping.task import StartState
from icub_tasks.grasping.termination import FIRST_FAULT, EndReason

StepRecorder = Callable[[int, GraspEnv, int, TensorDictBase], None]
"""Called after every step with world, environment, episode number and what that world's step gave (observation,
`action`, `reward`, `reason`), to take images and to tell listeners."""

WILSON_Z = 1.959963984540054


@dataclass(frozen=True, eq=False)
class EpisodeResults:
    """What happened in every episode, ordered by episode number.

    Attributes:
        success: (E,) bool.
        returns: (E,) sums of rewards.
        steps: (E,) control steps.
        reasons: (E,) `EndReason`; faults are failures.
        objects: Name of each episode's object.
        resamples: Object poses without a plan, which were drawn anew.
    """

    success: NDArray[np.bool_]
    returns: NDArray[np.float64]
    steps: NDArray[np.int64]
    reasons: NDArray[np.int64]
    objects: tuple[str, ...]
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
        """Return the number of episodes by end reason, lower case."""
        return {EndReason(int(r)).name.lower(): n for r, n in sorted(Counter(self.reasons.tolist()).items())}

    @property
    def faults(self) -> int:
        """Episodes that a fault ended."""
        return int((self.reasons >= FIRST_FAULT).sum())


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a binomial share."""
    if trials == 0:
        return 0.0, 1.0
    share, z2 = successes / trials, WILSON_Z**2
    middle = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = WILSON_Z * np.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    return float(max(middle - half, 0.0)), float(min(middle + half, 1.0))


def paired_gain(
    better: EpisodeResults, base: EpisodeResults, *, resamples: int = 10_000, seed: int = 0
) -> tuple[float, tuple[float, float]]:
    """Return the difference of success rates over the same starts and its 95 % bootstrap interval (over episodes)."""
    if len(better) != len(base) or better.objects != base.objects:
        raise ConfigError("a paired comparison needs results of the same episodes")
    difference = better.success.astype(np.float64) - base.success
    draws = np.random.default_rng(seed).integers(len(difference), size=(resamples, len(difference)))
    low, high = np.quantile(difference[draws].mean(axis=1), [0.025, 0.975])
    return float(difference.mean()), (float(low), float(high))


def evaluate(
    policy: Policy,
    env: GraspEnv,
    episodes: int,
    seed: int = 0,
    *,
    recorder: StepRecorder | None = None,
    progress: Progress | None = None,
    first: int = 0,
) -> EpisodeResults:
    """Run a policy deterministically for a number of episodes.

    Episode e starts from the generator seeded with (seed, e), planned afresh from its own image, in world e mod N:
    two policies evaluated with one seed in one environment meet the same starts, whatever they do in between.

    Args:
        policy: Acts.
        env: Its worlds are taken over; call `reset` before using it for anything else.
        episodes: How many.
        seed: Of the starts.
        recorder: Sees every step.
        progress: Told about finished episodes.
        first: Number of the first episode, for an evaluation done in parts.
    """
    if episodes < 1:
        raise ConfigError(f"evaluation of {episodes} episodes; expected at least 1")

    def start_of(world: int, episode: int) -> StartState:
        return env.batch.tasks[world].prepare(np.random.default_rng([seed, first + episode]))

    resamples_before = _resamples(env)
    results = run_episodes(policy, env, episodes, start_of, recorder=recorder, progress=progress)
    return replace(results, resamples=_resamples(env) - resamples_before)


def run_episodes(
    policy: Policy,
    env: GraspEnv,
    episodes: int,
    start_of: Callable[[int, int], StartState],
    *,
    recorder: StepRecorder | None = None,
    progress: Progress | None = None,
) -> EpisodeResults:
    """Run episodes whose starts `start_of(world, episode)` gives; episode e runs in world e mod N."""
    worlds = len(env.batch)
    success = np.zeros(episodes, dtype=np.bool_)
    returns = np.zeros(episodes)
    steps = np.zeros(episodes, dtype=np.int64)
    reasons = np.zeros(episodes, dtype=np.int64)
    names = [""] * episodes
    queues = [list(range(world, episodes, worlds))[::-1] for world in range(worlds)]

    def next_episode(world: int) -> int | None:
        if not queues[world]:
            return None
        episode = queues[world].pop()
        start = start_of(world, episode)
        env.begin(world, start)
        names[episode] = start.plan.object_name
        return episode

    running = [next_episode(world) for world in range(worlds)]
    observation = env.observe()
    finished = 0
    while any(episode is not None for episode in running):
        with torch.no_grad():
            action = observation["action"] = policy.act(observation)
        observation = env.advance(observation, [episode is not None for episode in running])
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
                recorder(world, env, episode, observation[world])
            if reason[world] == EndReason.RUNNING:
                continue
            success[episode] = reason[world] == EndReason.SUCCESS
            reasons[episode] = reason[world]
            finished += 1
            running[world] = next_episode(world)
            begun = True
            if progress is not None:
                progress(finished / episodes, f"{int(success.sum())} of {finished} grasped")
        if begun:
            observation = env.observe()
    return EpisodeResults(success, returns, steps, reasons, tuple(names))


def _resamples(env: GraspEnv) -> int:
    return sum(sum(task.plan_failures.values()) for task in env.batch.tasks)


def merge(results: Sequence[EpisodeResults]) -> EpisodeResults:
    """Put the results of several evaluations, such as one for each object, one after another."""
    return EpisodeResults(
        np.concatenate([r.success for r in results]),
        np.concatenate([r.returns for r in results]),
        np.concatenate([r.steps for r in results]),
        np.concatenate([r.reasons for r in results]),
        tuple(name for r in results for name in r.objects),
        sum(r.resamples for r in results),
    )
