"""Starts of episodes: planned afresh, or drawn again from those planned before.

Rendering, planning and the way to the pre-grasp pose cost more than a short episode. While a policy learns, a world
keeps the starts it has planned (each from its own image) and draws from them; a share of the starts stays fresh.
Evaluation always plans afresh.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Grasp
from icub_tasks.grasping.plan import GraspPlan
from icub_tasks.grasping.world import GraspWorld, StartState

Arrays = dict[str, NDArray[Any]]


class StartPool:
    """Starts of one world.

    Args:
        world: Plans them.
        size: Starts kept; 0 plans every one afresh.
        fresh: Share of the draws that are planned afresh once the pool is full; the new start replaces a random one.
        seed: Decides every draw.
    """

    def __init__(self, world: GraspWorld, size: int = 0, fresh: float = 0.05, seed: int = 0) -> None:
        self._world, self._size, self._fresh = world, size, fresh
        self.starts: list[StartState] = []
        self._rng = np.random.default_rng(seed)
        self.planned = 0

    def draw(self) -> StartState:
        """Return a start: until the pool is full every second one is new."""
        share = self._fresh if len(self.starts) >= self._size else 0.5
        if not self.starts or self._rng.random() < share:
            return self._plan()
        return self.starts[int(self._rng.integers(len(self.starts)))]

    def fill(self, count: int) -> None:
        """Plan until `count` starts are kept (at most the pool's size)."""
        while len(self.starts) < min(count, self._size):
            self._plan()

    def _plan(self) -> StartState:
        start = self._world.prepare(self._rng)
        self.planned += 1
        if len(self.starts) < self._size:
            self.starts.append(start)
        elif self._size:
            self.starts[int(self._rng.integers(self._size))] = start
        return start

    def state_dict(self) -> tuple[Arrays, str]:
        """Return the kept starts as arrays and the state of the random numbers as text."""
        return pack_starts(self.starts), json.dumps({"rng": self._rng.bit_generator.state, "planned": self.planned})

    def load_state_dict(self, arrays: Arrays, text: str) -> None:
        """Restore what `state_dict` returned."""
        self.starts = unpack_starts(arrays)
        kept = json.loads(text)
        self._rng.bit_generator.state = kept["rng"]
        self.planned = kept["planned"]


def pack_starts(starts: Sequence[StartState]) -> Arrays:
    """Write starts of one world as arrays, one row a start; names become UTF-8 bytes."""
    if not starts:
        return {}
    names = [[s.plan.object_name, s.plan.grasp.generator, s.plan.grasp.hand] for s in starts]
    rows: dict[str, list[Any]] = {
        "simulation": [s.simulation for s in starts],
        "q_command": [s.q_command for s in starts],
        "hand_target": [s.hand_target for s in starts],
        "command": [s.command for s in starts],
        "object_rest": [s.object_rest for s in starts],
        "T_world_hand": [s.plan.grasp.T_world_hand for s in starts],
        "object_center": [s.plan.grasp.object_center for s in starts],
        "score": [s.plan.grasp.score for s in starts],
        "T_far": [s.plan.T_far for s in starts],
        "T_near": [s.plan.T_near for s in starts],
        "q_far": [s.plan.q_far for s in starts],
    }
    arrays: Arrays = {
        name: np.stack([np.asarray(v, dtype=np.float64) for v in values]) for name, values in rows.items()
    }
    arrays["names"] = np.frombuffer(json.dumps(names).encode(), dtype=np.uint8).copy()
    return arrays


def unpack_starts(arrays: Arrays) -> list[StartState]:
    """Read what `pack_starts` wrote."""
    if not arrays:
        return []
    rows = {name: np.asarray(values, dtype=np.float64) for name, values in arrays.items() if name != "names"}
    names: list[tuple[str, str, str]] = json.loads(arrays["names"].tobytes())
    starts = []
    for i, (object_name, generator, hand) in enumerate(names):
        grasp = Grasp(rows["T_world_hand"][i], rows["object_center"][i], float(rows["score"][i]), generator, hand)
        plan = GraspPlan(object_name, grasp, rows["T_far"][i], rows["T_near"][i], rows["q_far"][i])
        start = (rows[name][i] for name in ("simulation", "q_command", "hand_target", "command", "object_rest"))
        starts.append(StartState(plan, *start))
    return starts
