"""Any task as a Gymnasium environment of one world."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase

from icub_core.api import make_env
from icub_core.interfaces.task import Task

FLAGS = ("success", "fault", "reason")
"""Entries of the task's observation that become `info`."""
Observation = dict[str, NDArray[np.float32]]


class GymTask(gymnasium.Env[Observation, NDArray[np.float32]]):
    """One world with a dictionary observation and actions in [-1, 1].

    `info` holds ``success``, ``reason`` (one of the task's) and ``fault``: never learn from a faulty transition.

    Args:
        task: A batch of one world; closed with this environment.
        render_mode: ``"rgb_array"`` or None.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 40}

    def __init__(self, task: Task, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self._task = task
        self._names = [str(name) for name in task.observation_spec.keys() if name not in FLAGS]
        self.action_space = spaces.Box(-1.0, 1.0, (task.action_spec.shape[-1],), np.float32)
        self.observation_space: spaces.Dict = spaces.Dict(  # type: ignore[assignment]
            {
                name: spaces.Box(-np.inf, np.inf, (task.observation_spec[name].shape[-1],), np.float32)
                for name in self._names
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; a seed makes it and all later ones repeatable."""
        super().reset(seed=seed)
        if seed is not None:
            self._task.set_seed(seed)
        start = self._task.draw(0)
        self._task.begin(0, start)
        return self._observation(self._task.observe()), {"object": start.target}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Do one control step."""
        entries = {"action": torch.from_numpy(np.asarray(action, dtype=np.float32)[None])}
        after = self._task.advance(TensorDict(entries, batch_size=[1]))
        info = {
            "success": bool(after["success"]),
            "fault": bool(after["fault"]),
            "reason": self._task.reasons[int(after["reason"])],
        }
        flags = bool(after["terminated"]), bool(after["truncated"])
        return self._observation(after), float(after["reward"]), *flags, info

    def render(self) -> NDArray[np.uint8] | None:
        """Return what the robot's camera sees (240, 320, 3), or None without a render mode."""
        return self._task.render_world(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Free the task."""
        self._task.close()

    def _observation(self, entries: TensorDictBase) -> Observation:
        return {name: entries[name][0].numpy() for name in self._names}


def gym_task(task: str, render_mode: str | None = None, **options: Any) -> GymTask:
    """Build a registered task; `options` are those of `icub_core.make_env`."""
    return GymTask(make_env(task, num_envs=1, **options), render_mode)
