"""RESPRECT: a residual policy on top of a frozen one, with critics that already know the task (thesis 13.3.2)."""

from __future__ import annotations

from pathlib import Path

import torch
from tensordict import TensorDictBase

from icub_core.errors import CheckpointError
from icub_core.interfaces.policy import LearnReport, Policy, Progress
from icub_policies.checkpoint import load_into, read_tensors, write_tensors
from icub_policies.features import features
from icub_policies.gpayn import weights_path
from icub_policies.networks import Actor
from icub_policies.sac import Sac, SacSettings
from icub_policies.training import Trainer, TrainingSettings
from icub_policies.visual import REPLAY_STEPS, for_weights, memory, seeing
from icub_tasks.grasping.env import GraspEnv
from icub_tasks.grasping.spaces import ACTION_SIZE

ENTROPY_COEFFICIENT = 0.01
"""Where the coefficient starts, in units of the task's reward (thesis table 13.1)."""
CRITIC_UPDATES = 1_500
"""Updates of the critics on the object at hand before the residual begins to move."""


CAUTION = 0.3
"""Weight of the squared residual: where critics see little to gain the base policy stays as it is."""


class Resprect(Policy):
    """Residual SAC with pre-trained critics.

    Executed is clip(a_pre + a_rl, -1, 1), where a_pre is the frozen base policy's action and a_rl that of the learned
    actor, which sees (s, a_pre). Critics judge the executed action and start from the base policy's critics; the
    memory keeps the residual. The residual's mean starts at exactly 0, so before learning this policy *is* the base
    policy (the released code offers that as an option and starts at random).

    DIFF to the thesis, for a budget of minutes, not days: the first `warm_up_steps` are collected and then trained
    on by the critics alone, so that they describe the object at hand before they move the actor; the actor pays for
    the size of its residual; exploration noise lasts over several steps and never falls below a least; four critics
    instead of two; the residual returned is the best one in the training-time evaluations, the zero residual included,
    so that learning never makes the base policy worse there.

    Args:
        base: Shipped weights by name or a file written by `Gpayn.save`.
        seconds: Wall-clock budget of `learn`.
        env_steps: Budget in control steps; the first budget that is spent ends learning.
        updates_per_step: Critic updates for each control step of one world (thesis 1).
        warm_up_steps: Control steps before the first actor update.
        seed: Of weights and sampling.
    """

    def __init__(
        self,
        base: str = "base_gpayn",
        seconds: float | None = 120.0,
        env_steps: int | None = None,
        updates_per_step: float = 0.5,
        warm_up_steps: int = 5_000,
        seed: int = 0,
    ) -> None:
        path = weights_path(base)
        tensors, _ = read_tensors(path)
        try:
            hidden, inputs = tensors["actor.layer1.weight"].shape
        except KeyError:
            raise CheckpointError(f"{path} holds no base policy; expected a file written by gpayn") from None
        self.base = Actor(inputs, ACTION_SIZE, hidden).requires_grad_(False)
        load_into(self.base, tensors, "actor.", path)
        scale = SacSettings().reward_scale
        settings = SacSettings(hidden=hidden, alpha=ENTROPY_COEFFICIENT * scale, learning_rate=1e-4, caution=CAUTION)
        self.sac = Sac(inputs, ACTION_SIZE, settings, residual=True, seed=seed)
        self.sac.load_critics(tensors, path)
        self.settings = TrainingSettings(
            seconds=seconds,
            env_steps=env_steps,
            updates_per_step=updates_per_step,
            warm_up_steps=warm_up_steps,
            critic_updates=CRITIC_UPDATES,
            evaluate_every=10_000,
        )

    def act(self, observation: TensorDictBase) -> torch.Tensor:
        """Return the base policy's action plus the most likely residual (B, 15), clipped to [-1, 1]."""
        with torch.no_grad():
            state = features(observation, self.sac.states)
            base = self._base_action(state)
            return self.sac.total(self.sac.actor.best(self.sac.actor_input(state, base)), base)

    def learn(self, env: GraspEnv, run_dir: Path, progress: Progress) -> LearnReport:
        """Learn the residual for the objects of `env`; an interrupted run in the same folder continues."""
        self.sac = seeing(self.sac, env)
        replay = memory(env, self.sac.states, REPLAY_STEPS, base=True)
        trainer = Trainer(
            env, self.sac, replay, self, self.settings, run_dir, base=self._base_action, progress=progress
        )  # fmt: skip
        trainer.resume()
        return trainer.run()

    def _base_action(self, state: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            # a base policy that never saw a image is not shown one
            return self.base.best(state[:, : self.base.layer1.in_features])

    def save(self, path: Path) -> None:
        """Write the base policy and what was learned."""
        base = {f"base.{name}": value for name, value in self.base.state_dict().items()}
        write_tensors(path, {**base, **self.sac.weights()}, {"policy": "resprect"})

    def load(self, path: Path) -> None:
        """Read what `save` wrote."""
        tensors, _ = read_tensors(path)
        self.sac = for_weights(self.sac, tensors, path)
        load_into(self.base, tensors, "base.", path)
        self.sac.load_weights(tensors, path)
