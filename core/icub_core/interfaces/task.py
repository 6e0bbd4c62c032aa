"""Task: a batch of worlds in which episodes begin, are stepped and end, as a TorchRL environment."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from icub_core.scene import CameraView

RUNNING = 0
"""The value of `reason` while an episode runs."""
SUCCESS = 1
"""The value of `reason` after success."""


class Start(Protocol):
    """Where an episode begins; what else it holds is the task's own affair."""

    @property
    def target(self) -> str:
        """Name of the object that the episode is about."""


class Task(EnvBase):
    """A batch of N worlds.

    A policy needs nothing beside `observation_spec`, `action_spec` and the entries of a step: `reward`, `done`,
    `terminated`, `truncated`, and ``success`` (N, 1) bool, ``fault`` (N, 1) bool (never learn from such a transition),
    ``reason`` (N, 1) int64, a position in `reasons`. What a robot knows is part of the observation; what is hidden
    from it in reality stands in `privileged` alone.

    Contract: sizes follow from the robot's description; the same start and actions give the same episode; worlds do
    not depend on one another; a fault ends its episode as a truncation; after `load_state_dict` the future is that of
    the task whose `state_dict` it was.
    """

    batch_locked = True

    @property
    @abstractmethod
    def reasons(self) -> tuple[str, ...]:
        """Names of the ends of an episode: ``running``, ``success``, then the task's own."""

    @property
    @abstractmethod
    def objects(self) -> tuple[str, ...]:
        """Names of the objects that episodes are about."""

    @property
    @abstractmethod
    def action_scale(self) -> torch.Tensor:
        """Return what an action of 1 changes in one step: (a,), meters and radians."""

    @property
    def observation_range(self) -> Mapping[str, tuple[torch.Tensor, torch.Tensor]]:
        """Return the usual lowest and highest values of some observations, for scaling; they may be exceeded."""
        return {}

    @abstractmethod
    def draw(self, world: int, rng: np.random.Generator | None = None) -> Start:
        """Return a start for one world.

        Args:
            world: Number of the world.
            rng: Decides the start completely, which is then planned afresh (evaluation). None takes the world's own
                random numbers; the task may then return a start that it has drawn before (learning).

        Raises:
            SimulationError: No start was found.
        """

    @abstractmethod
    def begin(self, world: int, start: Start) -> None:
        """Put one world at a start; the others stay as they are."""

    @abstractmethod
    def observe(self) -> TensorDictBase:
        """Return the present observation of all worlds, not done."""

    @abstractmethod
    def advance(self, tensordict: TensorDictBase, active: Sequence[bool] | None = None) -> TensorDictBase:
        """Do one control step with the entry ``action`` (N, a), leaving worlds that are not `active` as they are.

        Worlds that are done are not reset; what is returned of worlds that are not active means nothing.
        """

    def privileged(self) -> TensorDictBase:
        """Return the observation as a demonstrator may see it.

        Entries that reality makes wrong (a plan made from a wrong camera pose) are right here, and entries that a
        robot does not have at all may stand beside them. By default this is `observe`.
        """
        return self.observe()

    @abstractmethod
    def render_world(
        self, world: int, view: CameraView | None = None, width: int = 320, height: int = 240
    ) -> NDArray[np.uint8]:
        """Return an image (height, width, 3) of one world for people, from `view` or from the robot's camera."""

    @abstractmethod
    def fault_counts(self) -> Mapping[str, int]:
        """Return how many episodes ended so far, by name of the reason."""

    @property
    def resamples(self) -> int:
        """Starts that were drawn, found impossible, and drawn again so far."""
        return 0

    def card(self) -> dict[str, Any]:
        """Return what distinguishes figures of this task: variation, observation, where reward and end come from."""
        return {}

    @abstractmethod
    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return everything that decides the future."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        """Restore what `state_dict` returned, in a task made alike; CheckpointError, and no change, for another's."""

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.advance(tensordict)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        chosen: Sequence[int] = range(self.batch_size[0])
        if tensordict is not None and "_reset" in tensordict.keys():
            chosen = torch.nonzero(tensordict["_reset"].reshape(-1)).reshape(-1).tolist()
        for world in chosen:
            self.begin(world, self.draw(world))
        return self.observe()
