"""Faulty tasks."""

import itertools
from dataclasses import replace

import numpy as np
import torch

from icub_testing.tiny.task import TinyTask

from .base import breaks


@breaks("task", "check_specs")
class ShowsMoreThanItStates(TinyTask):
    def _entries(self):
        return {**super()._entries(), "surprise": torch.zeros(self.batch_size[0], 1)}


@breaks("task", "check_names")
class CannotRoll(TinyTask):
    @property
    def action_scale(self):
        scale = super().action_scale
        scale[5] = 0.0
        return scale


@breaks("task", "check_observation_after_begin")
class IsAboutSomethingElse(TinyTask):
    def draw(self, world, rng=None):
        return replace(super().draw(world, rng), target="a mug")


@breaks("task", "check_repeatable")
class StrongerByChance(TinyTask):
    """The future follows from the state, but two tasks made alike differ."""

    def __init__(self, num_envs: int = 2):
        super().__init__(num_envs=num_envs)
        self._strength = torch.from_numpy(np.random.default_rng().uniform(0.5, 0.9, 1)).float()

    def advance(self, tensordict, active=None):
        weaker = tensordict.clone()
        weaker["action"] = weaker["action"] * self._strength
        return super().advance(weaker, active)

    def state_dict(self):
        return {**super().state_dict(), "strength": self._strength.clone()}

    def load_state_dict(self, state):
        super().load_state_dict(state)
        self._strength = state["strength"].clone()


@breaks("task", "check_draws")
class CountsItsDraws(TinyTask):
    def __init__(self, num_envs: int = 2):
        super().__init__(num_envs=num_envs)
        self._drawn = itertools.count()

    def draw(self, world, rng=None):
        start = super().draw(world, rng)
        x, y, z = start.position
        return replace(start, position=(x + 0.001 * next(self._drawn), y, z))


@breaks("task", "check_worlds_apart")
class MovesEveryWorld(TinyTask):
    def advance(self, tensordict, active=None):
        return super().advance(tensordict)


@breaks("task", "check_faults")
class TerminatesAtAFault(TinyTask):
    def advance(self, tensordict, active=None):
        after = super().advance(tensordict, active)
        after["terminated"] = after["terminated"] | after["fault"]
        return after


@breaks("task", "check_privileged")
class HidesThePlanFromItsDemonstrator(TinyTask):
    def privileged(self):
        return self.observe().exclude("plan_grasp")


@breaks("task", "check_state")
class ForgetsItsClock(TinyTask):
    def load_state_dict(self, state):
        super().load_state_dict({**state, "steps": torch.zeros_like(state["steps"])})


@breaks("task", "check_images")
class DrawsUpright(TinyTask):
    def render_world(self, world, view=None, width=320, height=240):
        return super().render_world(world, view, height, width)


@breaks("task", "check_close_twice")
class ClosesOnce(TinyTask):
    freed = False

    def close(self, *, raise_if_closed=False):
        if self.freed:
            raise RuntimeError("freed already")
        self.freed = True
        super().close()
