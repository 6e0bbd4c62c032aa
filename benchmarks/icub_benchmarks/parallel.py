"""Evaluation in several processes: the same results however many there are.

The threads of a task share one interpreter, which is enough while a policy learns in one batch. Evaluation needs no
batch; processes neither wait for each other nor take each other down.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from icub_benchmarks.statistics import merge
from icub_benchmarks.workers import Workers
from icub_core.errors import ConfigError
from icub_core.interfaces.policy import Policy, Progress
from icub_core.interfaces.task import Task
from icub_core.rollouts import EpisodeResults, evaluate

PATIENCE = 900.0
"""Seconds a worker may take for one chunk of episodes; a chunk takes one or two minutes."""
WORKER_LOST = "worker_lost"
"""Name of the end of an episode whose process was lost."""


@dataclass(frozen=True)
class _Chunk:
    """Episodes `first` to `first + count - 1`, in worlds 0 to `count` - 1."""

    first: int
    count: int


def evaluate_in_workers(
    make_task: Callable[..., Task],
    make_policy: Callable[[], Policy],
    episodes: int,
    seed: int = 0,
    *,
    num_envs: int = 8,
    workers: int | None = None,
    progress: Progress | None = None,
) -> EpisodeResults:
    """Evaluate a policy as `evaluate` does, in several processes.

        make_task = functools.partial(icub.make_env, "grasp", objects=["004_sugar_box"])
        make_policy = functools.partial(icub.load, "policy", "demonstrations")
        print(evaluate_in_workers(make_task, make_policy, episodes=100).success_rate)

    Episode e starts from the generator seeded with (seed, e). Episodes go in chunks of `num_envs`, so neither the
    number of workers nor their order changes a result. Where a worker dies or hangs, its chunk is done again episode by
    episode, and only the one that takes its worker down again ends as `WORKER_LOST`, which counts as a fault.

    Args:
        make_task: Builds the task, called with `num_envs` in each process; can be pickled, as `make_policy` can.
        make_policy: Builds the policy in each process.
        episodes: How many.
        seed: Of the starts.
        num_envs: Worlds of each process.
        workers: Processes; None takes one for each core.
        progress: Told about finished episodes.
    """
    if episodes < 1:
        raise ConfigError(f"evaluation of {episodes} episodes; expected at least 1")
    chunks = [_Chunk(first, min(num_envs, episodes - first)) for first in range(0, episodes, num_envs)]
    count = min(workers or len(os.sched_getaffinity(0)), len(chunks))
    make = partial(_make_handler, partial(make_task, num_envs=num_envs), make_policy, seed)
    parts: dict[int, EpisodeResults] = {}
    with Workers(make, count, PATIENCE) as pool:
        for part, chunk in zip(pool.map(chunks, _telling(progress, len(chunks))), chunks, strict=True):
            if part is not None:
                parts[chunk.first] = part
        again = [_Chunk(e, 1) for c in chunks if c.first not in parts for e in range(c.first, c.first + c.count)]
        found = pool.map(again)
    reasons = next((p.reason_names for p in (*parts.values(), *found) if p is not None), ())
    if WORKER_LOST not in reasons:
        reasons = (*reasons, WORKER_LOST)
    for part, chunk in zip(found, again, strict=True):
        parts[chunk.first] = part if part is not None else _lost_episode(reasons.index(WORKER_LOST))
    return replace(merge([parts[first] for first in sorted(parts)]), reason_names=reasons)


def _make_handler(
    make_task: Callable[[], Task], make_policy: Callable[[], Policy], seed: int
) -> Callable[[_Chunk], EpisodeResults]:
    torch.set_num_threads(1)  # one process per core
    return partial(_run_chunk, make_task(), make_policy(), seed)


def _run_chunk(task: Task, policy: Policy, seed: int, chunk: _Chunk) -> EpisodeResults:
    return evaluate(policy, task, chunk.count, seed, first=chunk.first)


def _lost_episode(reason: int) -> EpisodeResults:
    reasons = np.array([reason], dtype=np.int64)
    steps = np.zeros(1, dtype=np.int64)
    return EpisodeResults(np.zeros(1, dtype=np.bool_), np.zeros(1), steps, reasons, ("",), faults=1)


def _telling(progress: Progress | None, chunks: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda over: progress(over / chunks, f"{over} of {chunks} parts")
