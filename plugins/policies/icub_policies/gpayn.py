"""G-PAYN: soft actor-critic that starts from demonstrations (thesis 12.3.2)."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import torch
from tensordict import TensorDictBase

from icub_core.errors import ConfigError
from icub_core.interfaces.policy import LearnReport, Policy, Progress
from icub_policies.checkpoint import read_tensors, write_tensors
from icub_policies.demonstrations import Demonstrations
from icub_policies.features import PROPRIOCEPTIVE_SIZE, features
from icub_policies.sac import Sac, SacSettings
from icub_policies.training import Trainer, TrainingSettings, demonstrate
from icub_policies.visual import REPLAY_STEPS, for_weights, memory, seeing
from icub_tasks.grasping.env import GraspEnv
from icub_tasks.grasping.spaces import ACTION_SIZE

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
        seconds: float | None = 120.0,
        env_steps: int | None = None,
        demonstrations: int = 100,
        updates_per_step: float = 0.25,
        hidden: int = 128,
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
        self.sac = Sac(PROPRIOCEPTIVE_SIZE, ACTION_SIZE, SacSettings(hidden=hidden), seed=seed)
        if weights is not None:
            self.load(weights_path(weights))

    def act(self, observation: TensorDictBase) -> torch.Tensor:
        """Return the most likely actions (B, 15)."""
        with torch.no_grad():
            return self.sac.actor.best(features(observation, self.sac.states))

    def learn(self, env: GraspEnv, run_dir: Path, progress: Progress) -> LearnReport:
        """Collect demonstrations, then learn; an interrupted run in the same folder continues."""
        self.sac = seeing(self.sac, env)
        shown = memory(env, self.sac.states, DEMONSTRATION_STEPS)
        replay = memory(env, self.sac.states, REPLAY_STEPS)
        trainer = Trainer(
            env, self.sac, replay, self, self.settings, run_dir,
            exports=self.exports, demonstrations=shown, progress=progress,
        )  # fmt: skip
        if not trainer.resume():
            demonstrate(env, Demonstrations(), shown, self._episodes, progress)
        return trainer.run()

    @classmethod
    def train(
        cls, run_dir: Path, seed: int, minutes: float = 45.0, progress: Progress = lambda share, text: None
    ) -> None:
        """Make the shipped base policy (``icub train policy=gpayn``): see `pretraining`."""
        from icub_policies.pretraining import pretrain

        pretrain(run_dir, seed, minutes, progress)

    def save(self, path: Path) -> None:
        """Write actor and critics."""
        write_tensors(path, self.sac.weights(), {"policy": "gpayn"})

    def load(self, path: Path) -> None:
        """Read what `save` wrote."""
        tensors, _ = read_tensors(path)
        self.sac = for_weights(self.sac, tensors, path)
        self.sac.load_weights(tensors, path)
