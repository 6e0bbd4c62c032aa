"""RESPRECT: a residual policy on top of a frozen one, with critics that already know the task (thesis 13.3.2)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import torch
from tensordict import TensorDictBase

from icub_core.bounds import above, at_least
from icub_core.errors import CheckpointError
from icub_core.interfaces.policy import LearnReport, Policy, Progress
from icub_core.interfaces.task import Task
from icub_policies.checkpoint import read_tensors, write_tensors
from icub_policies.gpayn import actions_of, weights_path
from icub_policies.inputs import Inputs
from icub_policies.learner import REPLAY_STEPS, for_weights, memory, seeing, states_of
from icub_policies.networks import Actor
from icub_policies.sac import Sac, SacSettings
from icub_policies.training import Trainer, TrainingSettings
from icub_support.weights import fill, part

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
        seconds: Annotated[float | None, above(0)] = 120.0,
        env_steps: Annotated[int | None, at_least(1)] = None,
        updates_per_step: Annotated[float, above(0)] = 0.5,
        warm_up_steps: Annotated[int, at_least(0)] = 5_000,
        seed: int = 0,
    ) -> None:
        path = weights_path(base)
        tensors, header = read_tensors(path)
        if "actor.layer1.weight" not in tensors:
            raise CheckpointError(f"{path} holds no base policy; expected a file written by gpayn")
        hidden, inputs = tensors["actor.layer1.weight"].shape
        actions = actions_of(tensors, path)
        self.base = Actor(inputs, actions, hidden).requires_grad_(False)
        fill(self.base, part(tensors, "actor"), f"actor in {path}")
        scale = SacSettings().reward_scale
        settings = SacSettings(hidden=hidden, alpha=ENTROPY_COEFFICIENT * scale, learning_rate=1e-4, caution=CAUTION)
        states = states_of(tensors, actions, path)
        sac = Sac(states, actions, settings, residual=True, seed=seed)
        self.sac, self.inputs = for_weights(sac, Inputs.read(header), tensors, path)
        self.sac.load_critics(tensors, path)
        self.settings = TrainingSettings(
            seconds=seconds,
            env_steps=env_steps,
            updates_per_step=updates_per_step,
            warm_up_steps=warm_up_steps,
            critic_updates=CRITIC_UPDATES,
            evaluate_every=10_000,
        )

    def bind(self, task: Task) -> None:
        """Check that the base policy's weights fit the task."""
        self.inputs.check(task, self.sac.actions)

    def act(self, observation: TensorDictBase) -> torch.Tensor:
        """Return the base policy's action plus the most likely residual (B, a), clipped to [-1, 1]."""
        with torch.no_grad():
            state = self.inputs(observation)
            base = self._base_action(state)
            return self.sac.total(self.sac.actor.best(self.sac.actor_input(state, base)), base)

    def learn(
        self,
        task: Task,
        run_dir: Path | None = None,
        progress: Progress | None = None,
        *,
        seconds: float | None = None,
    ) -> LearnReport:
        """Learn the residual for the objects of `task`; an interrupted run in the same folder continues."""
        self.bind(task)
        self.sac, self.inputs = seeing(self.sac, self.inputs, task)
        settings = self.settings if seconds is None else replace(self.settings, seconds=seconds)
        replay = memory(task, self.inputs, REPLAY_STEPS, base=True)
        trainer = Trainer(
            task, self.sac, self.inputs, replay, self, settings, run_dir, base=self._base_action, progress=progress
        )  # fmt: skip
        trainer.resume()
        return trainer.run()

    def _base_action(self, state: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            # a base policy that never saw an image is not shown one
            return self.base.best(state[:, : self.base.layer1.in_features])

    def save(self, path: Path) -> None:
        """Write the base policy and what was learned."""
        base = {f"base.{name}": value for name, value in self.base.state_dict().items()}
        header = {"policy": "resprect", "inputs": self.inputs.header()}
        write_tensors(path, {**base, **self.sac.weights()}, header)

    def load(self, path: Path) -> None:
        """Read what `save` wrote."""
        tensors, header = read_tensors(path)
        sac, inputs = for_weights(self.sac, Inputs.read(header), tensors, path)
        fill(self.base, part(tensors, "base"), f"base in {path}")
        sac.load_weights(tensors, path)
        self.sac, self.inputs = sac, inputs
