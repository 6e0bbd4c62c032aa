"""The grasping task as a TorchRL environment: a batch of worlds inside one environment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from icub_tasks.grasping.batch import TaskBatch
from icub_tasks.grasping.pool import StartPool
from icub_tasks.grasping.spaces import ACTION_SIZE, OBSERVATION_SIZES, PLAN, PLAN_SIZE, VISUAL
from icub_tasks.grasping.task import GraspTask, StartState
from icub_tasks.grasping.termination import EndReason
from icub_tasks.grasping.visual import VisualEncoder, VisualStack

FLAGS = ("success", "fault", "done", "terminated", "truncated")
"""Entries (N, 1) bool that a step gives."""


class GraspEnv(EnvBase):
    """Batch of N grasping worlds (thesis 12.3.1 as an MDP).

    Observation, float32: `hand_pose` (N, 6) world position and yaw, pitch, roll; `fingers` (N, 9) rad; `touch` (N, 5);
    `object_center` (N, 3) estimate at the start, world; `visual` (N, 5 F) with an encoder; `plan` (N, 7), privileged,
    for scripted policies only. Action (N, 15) in [-1, 1]. Next to reward and done, a step gives `success` (N, 1),
    `fault` (N, 1) (never learn from it) and `reason` (N, 1), an `EndReason`. The time limit and faults are truncations;
    success and a moved object are terminations.

    Args:
        tasks: The worlds.
        pool_size: Starts that each world keeps and draws again; 0 plans every start afresh.
        threads: Threads that step physics.
        encoder: Sees the head camera's image at every step; None leaves `visual` out.
        seed: Decides the starts.
    """

    batch_locked = True

    def __init__(
        self,
        tasks: Sequence[GraspTask],
        *,
        pool_size: int = 0,
        threads: int = 1,
        encoder: VisualEncoder | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(device="cpu", batch_size=torch.Size([len(tasks)]))
        self.batch = TaskBatch(tasks, threads)
        self._pool_size = pool_size
        self._visual = VisualStack(encoder, len(tasks)) if encoder is not None else None
        self._make_specs()
        self._set_seed(seed)

    def _make_specs(self) -> None:
        n = len(self.batch)
        sizes = {**OBSERVATION_SIZES, PLAN: PLAN_SIZE}
        if self._visual is not None:
            sizes[VISUAL] = self._visual.size
        self.observation_spec = Composite(
            {
                **{name: Unbounded(shape=(n, size), dtype=torch.float32) for name, size in sizes.items()},
                "success": Binary(n=1, shape=(n, 1), dtype=torch.bool),
                "fault": Binary(n=1, shape=(n, 1), dtype=torch.bool),
                "reason": Categorical(n=len(EndReason), shape=(n, 1), dtype=torch.int64),
            },
            shape=(n,),
        )
        self.action_spec = Bounded(low=-1.0, high=1.0, shape=(n, ACTION_SIZE), dtype=torch.float32)
        self.reward_spec = Unbounded(shape=(n, 1), dtype=torch.float32)
        flag = Binary(n=1, shape=(n, 1), dtype=torch.bool)
        self.done_spec = Composite({"done": flag, "terminated": flag.clone(), "truncated": flag.clone()}, shape=(n,))

    def _set_seed(self, seed: int | None) -> None:
        seeds = np.random.SeedSequence(seed or 0).generate_state(len(self.batch))
        self.pools = [
            StartPool(task, self._pool_size, seed=int(s)) for task, s in zip(self.batch.tasks, seeds, strict=True)
        ]

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        chosen = list(range(len(self.batch)))
        if tensordict is not None and "_reset" in tensordict.keys():
            chosen = torch.nonzero(tensordict["_reset"].reshape(-1)).reshape(-1).tolist()
        for world in chosen:
            self.begin(world, self.pools[world].draw())
        return self._observe()

    def begin(self, world: int, start: StartState) -> None:
        """Put one world at a given start (evaluation chooses its own)."""
        self.batch.begin(world, start)
        if self._visual is not None:
            self._visual.begin(world, self._picture(world))

    def observe(self) -> TensorDictBase:
        """Return the present observation of all worlds, not done."""
        return self._observe()

    def _observe(self) -> TensorDictBase:
        n = len(self.batch)
        entries: dict[str, torch.Tensor] = {k: torch.from_numpy(v) for k, v in self.batch.observation().items()}
        if self._visual is not None:
            entries[VISUAL] = self._visual.stacked()
        entries.update(zip(FLAGS, torch.zeros((len(FLAGS), n, 1), dtype=torch.bool).unbind(), strict=True))
        entries["reason"] = torch.zeros((n, 1), dtype=torch.int64)
        return TensorDict._new_unsafe(entries, batch_size=self.batch_size, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.advance(tensordict)

    def advance(self, tensordict: TensorDictBase, active: Sequence[bool] | None = None) -> TensorDictBase:
        """Do one control step with the entry `action` (N, 15), leaving worlds that are not `active` as they are."""
        result = self.batch.step(tensordict["action"].detach().numpy(), active)
        if self._visual is not None:
            for world in range(len(self.batch)):
                if active is None or active[world]:
                    self._visual.push(world, self._picture(world))
        reason = result.reason
        terminated = (reason == EndReason.SUCCESS) | (reason == EndReason.MOVED)
        done = reason != EndReason.RUNNING
        entries: dict[str, torch.Tensor] = {k: torch.from_numpy(v) for k, v in self.batch.observation().items()}
        if self._visual is not None:
            entries[VISUAL] = self._visual.stacked()
        entries["reward"] = torch.from_numpy(result.reward.astype(np.float32)[:, None])
        entries["reason"] = torch.from_numpy(reason[:, None])
        flags = np.stack([reason == EndReason.SUCCESS, result.fault, done, terminated, done & ~terminated])
        entries.update(zip(FLAGS, torch.from_numpy(flags[:, :, None]).unbind(), strict=True))
        return TensorDict._new_unsafe(entries, batch_size=self.batch_size, device=self.device)

    def save(self) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """Return everything that decides the future: worlds, episodes and starts as arrays, random numbers as text."""
        arrays: dict[str, np.ndarray] = {f"batch.{k}": v for k, v in self.batch.state().items()}
        texts = {}
        for world, pool in enumerate(self.pools):
            kept, text = pool.state()
            arrays.update({f"pool.{world}.{k}": v for k, v in kept.items()})
            texts[f"pool.{world}"] = text
        if self._visual is not None:
            arrays["visual"] = self._visual.state().numpy()
        return arrays, texts

    def restore(self, arrays: dict[str, np.ndarray], texts: dict[str, str]) -> None:
        """Take back what `save` returned, in an environment of the same tasks."""
        self.batch.restore(_part(arrays, "batch."))
        for world, pool in enumerate(self.pools):
            pool.restore(_part(arrays, f"pool.{world}."), texts[f"pool.{world}"])
        if self._visual is not None:
            self._visual.restore(torch.from_numpy(arrays["visual"]))

    def _picture(self, world: int) -> np.ndarray:
        task = self.batch.tasks[world]
        return task.look(self.batch.object_name(world)).frame.rgb

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Free every simulator."""
        self.batch.close()
        super().close(raise_if_closed=raise_if_closed)


def _part(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {key.removeprefix(prefix): value for key, value in arrays.items() if key.startswith(prefix)}
