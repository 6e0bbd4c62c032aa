"""Learners for the task at hand: made for its sizes, widened for its images, read from files, with a fitting memory."""

from __future__ import annotations

from pathlib import Path

import torch

from icub_core.errors import CheckpointError
from icub_core.interfaces.task import Task
from icub_policies.inputs import STACK, Inputs, other_images, with_images
from icub_policies.replay import Replay
from icub_policies.sac import Sac

REPLAY_STEPS = 1_000_000
"""Control steps of all worlds together that are kept (thesis)."""
REPLAY_BYTES = 2_000_000_000
"""With images fewer are kept, so that a laptop can hold them."""


def seeing(sac: Sac, inputs: Inputs, task: Task) -> tuple[Sac, Inputs]:
    """Return a learner, computing the same as `sac`, that also sees the images that a task shows.

    Raises:
        ConfigError: The learner sees images that the task does not show.
    """
    there = Inputs.of(task).visual
    if inputs.visual == there:
        return sac, inputs
    if inputs.visual:
        raise other_images(inputs.visual, there)
    wider = with_images(inputs, there)
    return sac.widened(wider.size, Path("the policy")), wider


def for_weights(sac: Sac, inputs: Inputs, tensors: dict[str, torch.Tensor], path: Path) -> tuple[Sac, Inputs]:
    """Return a learner with as many inputs as stored weights have, and those inputs.

    Args:
        sac: Of the right number of actions.
        inputs: As the file states them.
        tensors: The file's.
        path: Of the file, for messages.

    Raises:
        CheckpointError: The file holds no critics, or networks of an impossible size.
    """
    states = states_of(tensors, sac.actions, path)
    if not inputs.visual and states > inputs.size and not (states - inputs.size) % STACK:
        inputs = with_images(inputs, (states - inputs.size) // STACK)  # version 0.1 states no inputs
    if states != inputs.size:
        raise CheckpointError(f"{path} is of networks that see {states} entries; expected {inputs.size}")
    return (sac, inputs) if states == sac.states else (sac.resized(states), inputs)


def states_of(tensors: dict[str, torch.Tensor], actions: int, path: Path) -> int:
    """Return how many entries the state of stored critics has; CheckpointError for a file without critics."""
    if "critics.weight1" not in tensors:
        raise CheckpointError(f"{path} holds no critics; expected a file written by a policy of this project")
    return tensors["critics.weight1"].shape[0] - actions


def memory(task: Task, inputs: Inputs, steps: int, base: bool = False) -> Replay:
    """Return an empty memory of at most `steps` control steps of all worlds together, less when they are large."""
    worlds, actions = task.batch_size[0], task.action_spec.shape[-1]
    numbers = inputs.size - (STACK - 1) * inputs.visual + actions * (2 if base else 1)
    kept = min(steps, REPLAY_BYTES // (4 * numbers))
    return Replay(kept // worlds, worlds, inputs.size, actions, base=base, visual=inputs.visual)
