"""Starts of episodes: planned afresh, or drawn again from those planned before.

Rendering, planning and the way to the pre-grasp pose cost more than a short episode. While a policy learns, a world
keeps the starts it has planned (each from its own picture) and draws from them; a share of the starts stays fresh.
Evaluation always plans afresh.
"""

from __future__ import annotations

import numpy as np

from icub_core.grasping.task import GraspTask, StartState


class StartPool:
    """Starts of one world.

    Args:
        task: Plans them.
        size: Starts kept; 0 plans every one afresh.
        fresh: Share of the draws that are planned afresh once the pool is full; the new start replaces a random one.
        seed: Decides every draw.
    """

    def __init__(self, task: GraspTask, size: int = 0, fresh: float = 0.05, seed: int = 0) -> None:
        self._task, self._size, self._fresh = task, size, fresh
        self._starts: list[StartState] = []
        self._rng = np.random.default_rng(seed)
        self.planned = 0

    def draw(self) -> StartState:
        """Return a start: until the pool is full every second one is new."""
        share = self._fresh if len(self._starts) >= self._size else 0.5
        if not self._starts or self._rng.random() < share:
            return self._plan()
        return self._starts[int(self._rng.integers(len(self._starts)))]

    def fill(self, count: int) -> None:
        """Plan until `count` starts are kept (at most the pool's size)."""
        while len(self._starts) < min(count, self._size):
            self._plan()

    def _plan(self) -> StartState:
        start = self._task.prepare(self._rng)
        self.planned += 1
        if len(self._starts) < self._size:
            self._starts.append(start)
        elif self._size:
            self._starts[int(self._rng.integers(self._size))] = start
        return start
