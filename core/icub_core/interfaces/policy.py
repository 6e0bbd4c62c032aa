"""Policy: acts in the grasping task, and may learn in it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDictBase

if TYPE_CHECKING:
    from icub_tasks.grasping.env import GraspEnv

Progress = Callable[[float, str], None]
"""Called with the finished share (0..1) and a short text."""


@dataclass(frozen=True)
class LearnReport:
    """What learning took and gave; empty for a policy that does not learn."""

    seconds: float = 0.0
    env_steps: int = 0
    updates: int = 0
    episodes: int = 0
    metrics: dict[str, float] = field(default_factory=dict)


class Policy(ABC):
    """Maps observations of the grasping task to actions in [-1, 1]^15.

    Contract: `act` is deterministic and stateless for learned policies; actions are finite and within [-1, 1]; inputs
    are not changed; what `save` writes, `load` restores exactly.
    """

    @abstractmethod
    def act(self, observation: TensorDictBase) -> torch.Tensor:
        """Return actions (B, 15) float32 in [-1, 1] for a batch of observations (see `icub_tasks.grasping.env`)."""

    def learn(self, env: GraspEnv, run_dir: Path, progress: Progress) -> LearnReport:
        """Learn in `env` within the policy's own budget, with resumable checkpoints in `run_dir`.

        A policy that does not learn keeps this default, which does nothing.
        """
        return LearnReport()

    def save(self, path: Path) -> None:
        """Write the weights, without pickle, atomically. Nothing to write by default."""

    def load(self, path: Path) -> None:
        """Read what `save` wrote. Nothing to read by default."""
