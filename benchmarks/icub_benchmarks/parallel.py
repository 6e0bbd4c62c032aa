"""Evaluation on all cores: worlds in several processes, the same results however many there are.

Threads (`GraspEnv(threads=...)`) share one interpreter, which is enough while a policy learns in one batch; evaluation
needs no batch, and processes neither wait for each other nor take each other down.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch
from icub_tasks.grasping.env import GraspEnv

from icub_core.construct import build
from icub_core.errors import ConfigError
from icub_core.interfaces.policy import Policy, Progress
from icub_core.rollouts import EpisodeResults, evaluate, merge
from icub_core.scene import Scene
from icub_core.workers import Workers
from icub_tasks.grasping.task import GraspTask, TaskSettings
from icub_tasks.grasping.termination import EndReason

PluginConfig = str | dict[str, Any]
"""A plugin's name, or its constructor's parameters with the name under ``plugin``."""
PATIENCE = 900.0
"""Seconds a worker may take for one chunk of episodes; a chunk takes one or two minutes."""


@dataclass(frozen=True)
class EnvRecipe:
    """What a process needs to build a grasping environment of its own.

    Attributes:
        objects: Names of the objects to grasp; None takes all of the set.
        object_set, robot, simulator, generator: Plugins.
        hand: ``"right"`` or ``"left"``.
        worlds: Worlds of one environment.
        settings: Numbers of the task.
    """

    objects: tuple[str, ...] | None
    object_set: PluginConfig = "ycb_primitives"
    robot: PluginConfig = "icub"
    simulator: PluginConfig = "mujoco"
    generator: PluginConfig = "superquadrics"
    hand: str = "right"
    worlds: int = 8
    settings: TaskSettings = field(default_factory=TaskSettings)

    def build(self) -> GraspEnv:
        """Build the worlds."""
        robot = build("robot", self.robot)
        generator = build("grasp_generator", self.generator)
        objects = build("objects", self.object_set)
        names = objects.names if self.objects is None else self.objects
        scene = Scene(objects=tuple(objects.get(name) for name in names))
        tasks = []
        for _ in range(self.worlds):
            simulator = build("simulator", self.simulator)
            simulator.load(robot.description, scene)
            tasks.append(GraspTask(simulator, robot, generator, hand=self.hand, settings=self.settings))
        return GraspEnv(tasks)


@dataclass(frozen=True)
class _Chunk:
    """Episodes `first` to `first + count - 1`, in worlds 0 to `count` - 1."""

    first: int
    count: int


def evaluate_in_workers(
    recipe: EnvRecipe,
    policy: PluginConfig,
    episodes: int,
    seed: int = 0,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> EpisodeResults:
    """Evaluate a policy as `evaluate` does, in several processes.

    Episode e starts from the generator seeded with (seed, e). Episodes go in chunks of `recipe.worlds`, so neither the
    number of workers nor their order changes a result. Where a worker dies or hangs, its chunk is done again episode by
    episode, and only the one that takes its worker down again ends as `EndReason.WORKER_LOST`.

    Args:
        recipe: Each process builds its own worlds from it.
        policy: Each process builds its own.
        episodes: How many.
        seed: Of the starts.
        workers: Processes; None takes one for each core.
        progress: Told about finished episodes.
    """
    if episodes < 1:
        raise ConfigError(f"evaluation of {episodes} episodes; expected at least 1")
    size = recipe.worlds
    chunks = [_Chunk(first, min(size, episodes - first)) for first in range(0, episodes, size)]
    count = min(workers or len(os.sched_getaffinity(0)), len(chunks))
    parts: dict[int, EpisodeResults] = {}
    with Workers(partial(_make_handler, recipe, policy, seed), count, PATIENCE) as pool:
        for part, chunk in zip(pool.map(chunks, _telling(progress, len(chunks))), chunks, strict=True):
            if part is not None:
                parts[chunk.first] = part
        lost = [_Chunk(e, 1) for c in chunks if c.first not in parts for e in range(c.first, c.first + c.count)]
        for part, chunk in zip(pool.map(lost), lost, strict=True):
            parts[chunk.first] = part if part is not None else _lost_episode()
    return merge([parts[first] for first in sorted(parts)])


def _make_handler(recipe: EnvRecipe, policy: PluginConfig, seed: int) -> Callable[[_Chunk], EpisodeResults]:
    torch.set_num_threads(1)  # one process a core
    return partial(_run_chunk, recipe.build(), build("policy", policy), seed)


def _run_chunk(env: GraspEnv, policy: Policy, seed: int, chunk: _Chunk) -> EpisodeResults:
    return evaluate(policy, env, chunk.count, seed, first=chunk.first)


def _lost_episode() -> EpisodeResults:
    reason = np.array([EndReason.WORKER_LOST], dtype=np.int64)
    return EpisodeResults(np.zeros(1, dtype=np.bool_), np.zeros(1), np.zeros(1, dtype=np.int64), reason, ("",))


def _telling(progress: Progress | None, chunks: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda over: progress(over / chunks, f"{over} of {chunks} parts")
