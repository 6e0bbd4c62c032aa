"""Policies that see: learners with inputs for the task's images, and memories that can hold them."""

from __future__ import annotations

from pathlib import Path

import torch

from icub_core.errors import CheckpointError
from icub_policies.features import PROPRIOCEPTIVE_SIZE, STACK, other_pictures, visual_size
from icub_policies.replay import Replay
from icub_policies.sac import Sac
from icub_tasks.grasping.env import GraspEnv
from icub_tasks.grasping.spaces import ACTION_SIZE, VISUAL

REPLAY_STEPS = 1_000_000
"""Control steps of all worlds together that are kept (thesis)."""
REPLAY_BYTES = 2_000_000_000
"""With images fewer are kept, so that a laptop can hold them."""


def offered(env: GraspEnv) -> int:
    """Return the size of a state in `env`: 29, or 29 + 5 F."""
    spec = env.observation_spec
    return PROPRIOCEPTIVE_SIZE + (spec[VISUAL].shape[-1] if VISUAL in spec.keys() else 0)


def seeing(sac: Sac, env: GraspEnv) -> Sac:
    """Return a learner for what `env` offers, computing the same as `sac`.

    Raises:
        ConfigError: The learner sees images that `env` does not offer.
    """
    states = offered(env)
    if sac.states == states:
        return sac
    if sac.states != PROPRIOCEPTIVE_SIZE:
        raise other_pictures(sac.states, states)
    return sac.widened(states, Path("the policy"))


def for_weights(sac: Sac, tensors: dict[str, torch.Tensor], path: Path) -> Sac:
    """Return a learner with as many inputs as stored weights have.

    Raises:
        CheckpointError: The file holds no critics, or networks of an impossible size.
    """
    if "critics.weight1" not in tensors:
        raise CheckpointError(f"{path} holds no critics; expected a file written by a policy of this project")
    states = tensors["critics.weight1"].shape[0] - ACTION_SIZE
    if states == sac.states:
        return sac
    if sac.states != PROPRIOCEPTIVE_SIZE or states < sac.states or (states - sac.states) % STACK:
        raise CheckpointError(f"{path} is of networks that see {states} entries; expected {sac.states}")
    return sac.widened(states, path)


def memory(env: GraspEnv, states: int, steps: int, base: bool = False) -> Replay:
    """Return an empty memory of at most `steps` control steps of all worlds together, less when they are large."""
    visual = visual_size(states)
    numbers = states - (STACK - 1) * visual + ACTION_SIZE * (2 if base else 1)
    kept = min(steps, REPLAY_BYTES // (4 * numbers))
    worlds = len(env.batch)
    return Replay(kept // worlds, worlds, states, ACTION_SIZE, base=base, visual=visual)
