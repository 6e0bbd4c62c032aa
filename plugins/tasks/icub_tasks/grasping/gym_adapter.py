"""The grasping task as a Gymnasium environment of one world."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from icub_tasks.grasping.batch import TaskBatch
from icub_tasks.grasping.pool import StartPool
from icub_tasks.grasping.spaces import ACTION_SIZE, OBSERVATION_SIZES
from icub_tasks.grasping.task import GraspTask
from icub_tasks.grasping.termination import EndReason


class GymGraspEnv(gymnasium.Env[dict[str, NDArray[np.float32]], NDArray[np.float32]]):
    """One grasping world with a dictionary observation and actions (15,) in [-1, 1].

    `info` holds ``success``, ``reason`` (an `EndReason` name) and ``fault``: never learn from a faulty transition.

    Args:
        task: The world.
        render_width, render_height: Pixels of the head camera's images from `render`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 40}

    def __init__(self, task: GraspTask, render_width: int = 320, render_height: int = 240) -> None:
        self.render_mode = "rgb_array"
        self.action_space = spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)
        self.observation_space: spaces.Dict = spaces.Dict(  # type: ignore[assignment]
            {name: spaces.Box(-np.inf, np.inf, (size,), np.float32) for name, size in OBSERVATION_SIZES.items()}
        )
        self._task = task
        self._batch = TaskBatch([task])
        self._starts = StartPool(task, seed=0)
        self._render_size = (render_width, render_height)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
        """Plan a new start; a seed makes it and all later ones repeatable."""
        super().reset(seed=seed)
        if seed is not None:
            self._starts = StartPool(self._task, seed=seed)
        self._batch.begin(0, self._starts.draw())
        return self._observation(), {"object": self._batch.object_name(0)}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[dict[str, NDArray[np.float32]], float, bool, bool, dict[str, Any]]:
        """Do one control step of 25 ms."""
        result = self._batch.step(np.asarray(action, dtype=np.float64)[None])
        reason = EndReason(int(result.reason[0]))
        terminated = reason in (EndReason.SUCCESS, EndReason.MOVED)
        truncated = reason != EndReason.RUNNING and not terminated
        info = {"success": reason is EndReason.SUCCESS, "reason": reason.name, "fault": bool(result.fault[0])}
        return self._observation(), float(result.reward[0]), terminated, truncated, info

    def render(self) -> NDArray[np.uint8]:
        """Return the head camera's image (H, W, 3)."""
        width, height = self._render_size
        simulator = self._task.simulator
        center = simulator.object_pose(self._batch.object_name(0))[:3, 3]
        return simulator.render(self._task.camera, width, height, look_at=center).frame.rgb

    def close(self) -> None:
        """Free the simulator."""
        self._batch.close()

    def _observation(self) -> dict[str, NDArray[np.float32]]:
        observation = self._batch.observation()
        return {name: observation[name][0] for name in OBSERVATION_SIZES}
