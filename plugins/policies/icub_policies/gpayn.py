"""G-PAYN: soft actor-critic that starts from demonstrations (thesis 12.3.2)."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Annotated

import torch
from tensordict import TensorDictBase

from icub_core.bounds import above, at_least
from icub_core.errors import CheckpointError, ConfigError
from icub_core.interfaces.policy import LearnReport, Policy, Progress
from icub_core.interfaces.task import Task
from icub_policies.checkpoint import read_tensors, write_tensors
from icub_policies.demonstrations import Demonstrations
from icub_policies.inputs import Inputs, with_images
from icub_policies.learner import REPLAY_STEPS, for_weights, memory, seeing, states_of
from icub_policies.sac import Sac, SacSettings
from icub_policies.training import Trainer, TrainingSettings, demonstrate

SHIPPED = ("base_gpayn",)
DEMONSTRATION_STEPS = 300_000
"""Most control steps of all worlds together that are kept."""
IMITATION_UPDATES = 4_000
WARM_UP_UPDATES = 2_000
CRITIC_UPDATES = 10_000
IMITATION = 2.0


def weights_path(weights: str) -> Path:
    """Return the file of shipped weights by name, or of the user's by path."""
    if weights in SHIPPED:
        return Path(str(resources.files("icub_policies") / "weights" / f"{weights}.safetensors"))
    path = Path(weights)
    if not path.is_file():
        raise ConfigError(f"weights '{weights}': neither a file nor one of the shipped {list(SHIPPED)}")
    return path


class Gpayn(Policy):
    """SAC whose memory holds demonstrations from the start.

    Four stages: scripted demonstrations fill the memory; the actor imitates them; it acts unchanged, with noise, until
    the critics know what its actions are worth; then soft actor-critic improves it.

    DIFF to the thesis, which runs five million steps: the imitation and the frozen stage are added (SAC from a random
    actor learns nothing within minutes, and one that moves before its critics are right forgets how to grasp); the
    demonstrations are kept for ever at half of every batch instead of leaving a first-in-first-out memory; imitation
    stays in the actor's loss with a weight that falls to 0 at half of the budget; what is returned is the best of the
    training-time evaluations. See `sac` and `training` for the rest.

    Args:
        weights: Shipped weights by name (``"base_gpayn"``) or a file to start from; None starts at random.
        seconds: Wall-clock budget of `learn`.
        env_steps: Budget in control steps; the first budget that is spent ends learning.
        demonstrations: Scripted episodes at the start.
        updates_per_step: Critic updates for each control step of one world.
        hidden: Units of each of the two layers.
        seed: Of weights and sampling.
    """

    def __init__(
        self,
        weights: str | None = None,
        seconds: Annotated[float | None, above(0)] = 120.0,
        env_steps: Annotated[int | None, at_least(1)] = None,
        demonstrations: Annotated[int, at_least(1)] = 100,
        updates_per_step: Annotated[float, above(0)] = 0.25,
        hidden: Annotated[int, at_least(1)] = 128,
        seed: int = 0,
    ) -> None:
        self.settings = TrainingSettings(
            seconds=seconds,
            env_steps=env_steps,
            updates_per_step=updates_per_step,
            imitation_updates=IMITATION_UPDATES,
            warm_up_updates=WARM_UP_UPDATES,
            critic_updates=WARM_UP_UPDATES + CRITIC_UPDATES,
            imitation=IMITATION,
        )
        self.exports: Path | None = None
        self._episodes = demonstrations
        self._sac_settings, self._seed = SacSettings(hidden=hidden), seed
        self._learner: tuple[Sac, Inputs] | None = None
        if weights is not None:
            self.load(weights_path(weights))

    @property
    def sac(self) -> Sac:
        """The learner; ConfigError before its sizes are known from weights or from a task."""
        return self._ready()[0]

    def _ready(self) -> tuple[Sac, Inputs]:
        if self._learner is None:
            raise ConfigError("the policy 'gpayn' has neither weights nor a task; call policy.bind(task) first")
        return self._learner

    def bind(self, task: Task) -> None:
        """Take sizes from the task, or check that the weights fit it."""
        actions = task.action_spec.shape[-1]
        if self._learner is None:
            inputs = with_images(Inputs.of(task), 0)
            self._learner = Sac(inputs.size, actions, self._sac_settings, seed=self._seed), inputs
        self._learner[1].check(task, self._learner[0].actions)

    def act(self, observation: TensorDictBase) -> torch.Tensor:
        """Return the most likely actions (B, a)."""
        sac, inputs = self._ready()
        with torch.no_grad():
            return sac.actor.best(inputs(observation))

    def learn(
        self,
        task: Task,
        run_dir: Path | None = None,
        progress: Progress | None = None,
        *,
        seconds: float | None = None,
    ) -> LearnReport:
        """Collect demonstrations, then learn; an interrupted run in the same folder continues."""
        self.bind(task)
        sac, inputs = self._learner = seeing(*self._ready(), task)
        settings = self.settings if seconds is None else replace(self.settings, seconds=seconds)
        shown = memory(task, inputs, DEMONSTRATION_STEPS)
        replay = memory(task, inputs, REPLAY_STEPS)
        trainer = Trainer(
            task, sac, inputs, replay, self, settings, run_dir,
            exports=self.exports, demonstrations=shown, progress=progress,
        )  # fmt: skip
        if not trainer.resume():
            demonstrate(task, Demonstrations(), inputs, shown, self._episodes, progress)
        return trainer.run()

    def save(self, path: Path) -> None:
        """Write actor and critics."""
        sac, inputs = self._ready()
        write_tensors(path, sac.weights(), {"policy": "gpayn", "inputs": inputs.header()})

    def load(self, path: Path) -> None:
        """Read what `save` wrote."""
        tensors, header = read_tensors(path)
        inputs, actions = Inputs.read(header), actions_of(tensors, path)
        states = states_of(tensors, actions, path)
        sac, inputs = for_weights(Sac(states, actions, self._sac_settings, seed=self._seed), inputs, tensors, path)
        sac.load_weights(tensors, path)
        self._learner = sac, inputs


def actions_of(tensors: dict[str, torch.Tensor], path: Path) -> int:
    """Return how many actions a stored actor has; CheckpointError for a file without one."""
    if "actor.mean.bias" not in tensors:
        raise CheckpointError(f"{path} holds no policy; expected a file written by gpayn or resprect")
    return len(tensors["actor.mean.bias"])
