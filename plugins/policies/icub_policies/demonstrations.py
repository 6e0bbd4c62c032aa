"""Scripted grasps that serve as demonstrations (thesis 12.3.2, algorithm 4)."""

from __future__ import annotations

from typing import Annotated

import torch
from tensordict import TensorDictBase

from icub_core.bounds import above, at_least
from icub_core.errors import ConfigError
from icub_core.interfaces.policy import Policy
from icub_core.interfaces.task import Task

PLAN = ("plan_start", "plan_grasp", "plan_opened", "plan_closed", "step", "fingers")
"""Observations of the grasping task that the script reads."""


class Demonstrations(Policy):
    """Scripted grasp: straight to the planned pose, fingers closed adaptively, then up.

    Closing step k of K commands each finger to min(q + D / rate, open + D k / K), with D = close - open and q the
    measured length (max where D is negative); during the lift the last of these offsets stays. The policy needs no
    memory: it reads the plan and the step number, which the robot knows.

    DIFF to the thesis, each found by measurement on this robot (clean poses and poses with 15 mm / 0.2 rad errors):
    the finger lead is D/25 as in the released code (with D/250 the servos never overcome the finger joints' damping);
    closing takes 100 steps instead of 500 (same success, episodes a third as long); the approach runs at the 2 mm per
    step of the action space instead of 0.5 mm and ends 1 cm past the grasp pose, stopped by contact (released code:
    5 cm past it). `approach_step=0.0005, closing_steps=500, past=0.0, rate=250` gives the thesis's numbers.

    Args:
        closing_steps: K.
        rate: Largest finger lead is D / rate.
        approach_step: Meters per step towards the grasp; at most what an action of 1 moves.
        past: Meters that the approach continues beyond the grasp pose.
    """

    def __init__(
        self,
        closing_steps: Annotated[int, at_least(1)] = 100,
        rate: Annotated[float, above(0)] = 25.0,
        approach_step: Annotated[float, above(0)] = 0.002,
        past: float = 0.01,
    ) -> None:
        self._closing_steps, self._rate = closing_steps, rate
        self._approach_step, self._past = approach_step, past
        self._scale: torch.Tensor | None = None

    def bind(self, task: Task) -> None:
        """Take the meaning of actions from the task; ConfigError where it states no plan."""
        missing = [name for name in PLAN if name not in task.observation_spec.keys()]
        if missing:
            raise ConfigError(
                f"the policy 'demonstrations' follows a plan, but the task does not observe '{missing[0]}'"
            )
        scale = task.action_scale
        if self._approach_step > float(scale[0]) * (1 + 1e-6):
            raise ConfigError(
                f"policy.approach_step={self._approach_step} is more than an action can move; "
                f"expected at most {float(scale[0]):g} m"
            )
        self._scale = scale

    def act(self, observation: TensorDictBase) -> torch.Tensor:
        """Return the scripted actions (B, 6 + F)."""
        if self._scale is None:
            raise ConfigError("the policy 'demonstrations' must be bound to a task before it acts: policy.bind(task)")
        start, grasp, opened, closed, step, fingers = (observation[name] for name in PLAN)
        step, translation = step[:, 0], float(self._scale[0])
        way = grasp - start
        length = way.norm(dim=1)
        approach_steps = torch.ceil((length + self._past) / self._approach_step)
        k = (step - approach_steps + 1).clamp(0, self._closing_steps)
        action = torch.zeros(len(start), len(self._scale))
        approaching = step < approach_steps
        per_step = (length + self._past) / approach_steps / translation
        direction = way / length.clamp_min(1e-6)[:, None]
        action[:, :3] = torch.where(approaching[:, None], direction * per_step[:, None], 0.0)
        action[:, 2] += (step >= approach_steps + self._closing_steps).float()  # lift: as fast as an action moves
        span = closed - opened
        lead, due = span / self._rate, opened + span * (k / self._closing_steps)[:, None] - fingers
        offset = torch.where(span < 0, torch.maximum(lead, due), torch.minimum(lead, due))
        action[:, 6:] = torch.where(approaching[:, None], 0.0, offset / self._scale[6:])
        return action.clamp_(-1.0, 1.0)
