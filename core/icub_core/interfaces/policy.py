"""Policy: acts in a task, and may learn in it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from tensordict import TensorDictBase

from icub_core.interfaces.task import Task

Progress = Callable[[float, str], None]
"""Called with the finished share (0..1) and a short text."""


@dataclass(frozen=True)
class LearnReport:
    """What learning took and gave."""

    seconds: float = 0.0
    env_steps: int = 0
    updates: int = 0
    episodes: int = 0
    metrics: dict[str, float] = field(default_factory=dict)


class Policy(ABC):
    """Maps observations of a task to actions in [-1, 1].

    Contract: `act` is deterministic and stateless; actions are finite and within [-1, 1]; inputs are not changed.

    A policy that learns, or whose weights can be kept, has the methods of `Learns` and `HasWeights` in
    `icub_core.interfaces.abilities`.
    """

    def bind(self, task: Task) -> None:
        """Take sizes and scales from the task in which the policy will act; called before `act`.

        A policy that needs none keeps this default.

        Raises:
            ConfigError: The policy's weights are made for other observations or actions.
        """

    @abstractmethod
    def act(self, observation: TensorDictBase) -> torch.Tensor:
        """Return actions (B, a) float32 in [-1, 1] for a batch of observations (the task's `observation_spec`)."""
