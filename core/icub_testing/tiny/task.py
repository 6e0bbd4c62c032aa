"""A point that is pushed to a goal on a line: the smallest task, with the observations that grasping policies read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded

from icub_core.errors import CheckpointError, ConfigError
from icub_core.interfaces.task import RUNNING, SUCCESS, Start, Task
from icub_core.scene import CameraView

TIME_LIMIT, FAULT = 2, 3
STEP = 0.02
"""Meters that an action of 1 moves the hand."""
NEAR = 0.01
"""Meters from the goal that count as success."""


@dataclass(frozen=True)
class TinyStart:
    """Where the hand is and where it should be, meters."""

    position: tuple[float, float, float]
    goal: tuple[float, float, float]
    target: str = "goal"


class TinyTask(Task):
    """Move the hand to a goal; an action that is not finite is a fault.

    Args:
        num_envs: Worlds.
        fingers: Actuators of the hand, whose action only moves what is observed of them.
        fingertips: Entries of `touch`.
        max_steps: Time limit.
        seed: Decides the starts.
    """

    def __init__(
        self, num_envs: int = 2, fingers: int = 4, fingertips: int = 3, max_steps: int = 20, seed: int = 0
    ) -> None:
        super().__init__(device="cpu", batch_size=torch.Size([num_envs]))
        self._fingers, self._max_steps = fingers, max_steps
        sizes = {"hand_pose": 6, "fingers": fingers, "touch": fingertips, "object_center": 3, "step": 1}
        sizes |= {"plan_start": 3, "plan_grasp": 3, "plan_opened": fingers, "plan_closed": fingers}
        n = num_envs
        flags = {name: Binary(n=1, shape=(n, 1), dtype=torch.bool) for name in ("success", "fault")}
        self.observation_spec = Composite(
            {
                **{name: Unbounded(shape=(n, size), dtype=torch.float32) for name, size in sizes.items()},
                **flags,
                "reason": Categorical(n=len(self.reasons), shape=(n, 1), dtype=torch.int64),
            },
            shape=(n,),
        )
        self.action_spec = Bounded(low=-1.0, high=1.0, shape=(n, 6 + fingers), dtype=torch.float32)
        self.reward_spec = Unbounded(shape=(n, 1), dtype=torch.float32)
        flag = Binary(n=1, shape=(n, 1), dtype=torch.bool)
        self.done_spec = Composite({"done": flag, "terminated": flag.clone(), "truncated": flag.clone()}, shape=(n,))
        self._touch = torch.zeros(n, fingertips)
        self._position, self._goal, self._begun = torch.zeros(n, 3), torch.zeros(n, 3), torch.zeros(n, 3)
        self._lengths, self._steps = torch.zeros(n, fingers), torch.zeros(n, 1)
        self._ends = torch.zeros(len(self.reasons), dtype=torch.int64)
        self._set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        self._rngs = [np.random.default_rng([seed or 0, world]) for world in range(self.batch_size[0])]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Names of the ends."""
        return ("running", "success", "time_limit", "action_not_finite")

    @property
    def objects(self) -> tuple[str, ...]:
        """The goal."""
        return ("goal",)

    @property
    def action_scale(self) -> torch.Tensor:
        """Meters, then radians."""
        return torch.tensor([STEP] * 3 + [0.01] * 3 + [0.2] * self._fingers)

    def draw(self, world: int, rng: np.random.Generator | None = None) -> TinyStart:
        """Draw a hand above a table and a goal near it."""
        stream = self._rngs[world] if rng is None else rng
        goal = np.array([-0.35, 0.0, 1.03]) + stream.uniform(-0.03, 0.03, 3)
        start = goal + stream.uniform(-0.06, 0.06, 3)
        return TinyStart(tuple(map(float, start)), tuple(map(float, goal)))  # type: ignore[arg-type]

    def begin(self, world: int, start: Start) -> None:
        """Put the hand of one world at its start."""
        if not isinstance(start, TinyStart):
            raise ConfigError(f"a start of the tiny task is what draw() returns; got {type(start).__name__}")
        self._position[world] = self._begun[world] = torch.tensor(start.position)
        self._goal[world] = torch.tensor(start.goal)
        self._lengths[world], self._steps[world] = 0.0, 0.0

    def observe(self) -> TensorDictBase:
        """Return the present observation."""
        n = self.batch_size[0]
        false = torch.zeros(n, 1, dtype=torch.bool)
        flags = {name: false.clone() for name in ("success", "fault", "done", "terminated", "truncated")}
        entries = {**self._entries(), **flags, "reason": torch.zeros(n, 1, dtype=torch.int64)}
        return TensorDict(entries, batch_size=self.batch_size)

    def _entries(self) -> dict[str, torch.Tensor]:
        pose = torch.cat([self._position, torch.full_like(self._position, 3.1)], dim=1)
        return {
            "hand_pose": pose,
            "fingers": self._lengths.clone(),
            "touch": self._touch.clone(),
            "object_center": self._goal.clone(),
            "plan_start": self._begun.clone(),
            "plan_grasp": self._goal.clone(),
            "plan_opened": torch.zeros_like(self._lengths),
            "plan_closed": torch.ones_like(self._lengths),
            "step": self._steps.clone(),
        }

    def advance(self, tensordict: TensorDictBase, active: Sequence[bool] | None = None) -> TensorDictBase:
        """Move every active hand by its action."""
        n = self.batch_size[0]
        going = torch.ones(n, dtype=torch.bool) if active is None else torch.tensor(list(active))
        action = tensordict["action"].detach().clone()
        bad = ~torch.isfinite(action).all(dim=1)
        action[bad] = 0.0
        change = action.clamp(-1.0, 1.0) * self.action_scale * going[:, None]
        before = (self._goal - self._position).norm(dim=1)
        self._position = self._position + change[:, :3]
        self._lengths = self._lengths + change[:, 6:]
        self._steps = self._steps + going[:, None].float()
        left = (self._goal - self._position).norm(dim=1)
        reason = torch.where(self._steps[:, 0] >= self._max_steps, TIME_LIMIT, RUNNING)
        reason = torch.where(left < NEAR, SUCCESS, reason)
        reason = torch.where(bad, FAULT, reason)
        self._ends += torch.bincount(reason[going & (reason != RUNNING)], minlength=len(self.reasons))
        success, done = reason == SUCCESS, reason != RUNNING
        reward = torch.where(bad, 0.0, 100.0 * (before - left))
        entries = {**self._entries(), "reward": reward[:, None], "reason": reason[:, None]}
        flags = {"success": success, "fault": bad, "done": done, "terminated": success, "truncated": done & ~success}
        entries |= {name: flag[:, None] for name, flag in flags.items()}
        return TensorDict(entries, batch_size=self.batch_size)

    def render_world(
        self, world: int, view: CameraView | None = None, width: int = 320, height: int = 240
    ) -> NDArray[np.uint8]:
        """Return a gray image that is lighter the nearer the goal is."""
        left = float((self._goal[world] - self._position[world]).norm())
        return np.full((height, width, 3), int(255 / (1 + 100 * left)), dtype=np.uint8)

    def fault_counts(self) -> dict[str, int]:
        """Return how many episodes ended so far, by reason."""
        return {name: int(n) for name, n in zip(self.reasons, self._ends, strict=True) if n}

    def card(self) -> dict[str, Any]:
        """Name the task."""
        return {"task": "tiny", "variation": "nominal"}

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return positions, clocks and random numbers."""
        state = {name: getattr(self, f"_{name}").clone() for name in _STATE}
        for world, rng in enumerate(self._rngs):
            inner = rng.bit_generator.state["state"]
            parts = [inner[key] >> shift & (2**32 - 1) for key in ("state", "inc") for shift in (0, 32, 64, 96)]
            state[f"rng.{world}"] = torch.tensor(parts, dtype=torch.int64)
        return state

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        """Restore what `state_dict` returned."""
        for name in _STATE:
            if name not in state or state[name].shape != getattr(self, f"_{name}").shape:
                raise CheckpointError(f"the state is of another task: '{name}' is missing or has another shape")
        for name in _STATE:
            setattr(self, f"_{name}", state[name].clone())
        for world, rng in enumerate(self._rngs):
            parts = [int(v) for v in state[f"rng.{world}"]]
            whole = [sum(v << 32 * k for k, v in enumerate(parts[first : first + 4])) for first in (0, 4)]
            rng.bit_generator.state = {
                **rng.bit_generator.state,
                "state": {"state": whole[0], "inc": whole[1]},
            }

    def close(self, *, raise_if_closed: bool = False) -> None:
        """Close; may be called twice."""
        if not self.is_closed:
            super().close(raise_if_closed=raise_if_closed)


_STATE = ("position", "goal", "begun", "lengths", "steps", "ends")
