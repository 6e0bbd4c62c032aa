"""Scripted grasps that serve as demonstrations (thesis 12.3.2, algorithm 4)."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase

from icub_core.errors import ConfigError
from icub_core.interfaces.policy import Policy
from icub_tasks.grasping.spaces import (
    ACTION_SIZE,
    FINGERS,
    PLAN,
    PLAN_CLOSED,
    PLAN_FINGER_STEP,
    PLAN_GRASP,
    PLAN_OPENED,
    PLAN_START,
    PLAN_STEP,
    TRANSLATION_STEP,
)


class Demonstrations(Policy):
    """Straight to the planned grasp, fingers closed adaptively, then up.

    Closing step k of K commands each finger to min(q + D / rate, open + D k / K), with D = close - open and q the
    measured length; during the lift the last of these offsets stays. The policy needs no memory: it reads plan and
    step number from the privileged entry `plan`, so it is no baseline of the learned policies but their teacher.

    DIFF to the thesis, each found by measurement on this robot (clean poses and poses with 15 mm / 0.2 rad errors):
    the finger lead is D/25 as in the released code (with D/250 the servos never overcome the finger joints' damping);
    closing takes 100 steps instead of 500 (same success, episodes a third as long); the approach runs at the 2 mm a
    step of the action space instead of 0.5 mm and ends 1 cm past the grasp pose, stopped by contact (released code:
    5 cm past it). `approach_step=0.0005, closing_steps=500, past=0.0, rate=250` gives the thesis's numbers.

    Args:
        closing_steps: K.
        rate: Largest finger lead is D / rate.
        approach_step: Meters a step towards the grasp.
        past: Meters that the approach goes on beyond the grasp pose.
    """

    def __init__(
        self, closing_steps: int = 100, rate: float = 25.0, approach_step: float = 0.002, past: float = 0.01
    ) -> None:
        if closing_steps < 1 or rate <= 0 or not 0 < approach_step <= TRANSLATION_STEP:
            raise ConfigError(
                f"demonstrations: closing_steps {closing_steps}, rate {rate}, approach_step {approach_step}; "
                f"expected at least 1, above 0, above 0 and at most {TRANSLATION_STEP} m"
            )
        self._closing_steps, self._rate = closing_steps, rate
        self._approach_step, self._past = approach_step, past

    def act(self, observation: TensorDictBase) -> torch.Tensor:
        """Return the scripted actions (B, 15); reads `fingers` and the privileged `plan`."""
        plan, fingers = observation[PLAN], observation[FINGERS]
        step = plan[:, PLAN_STEP]
        way = plan[:, PLAN_GRASP] - plan[:, PLAN_START]
        length = way.norm(dim=1)
        approach_steps = torch.ceil((length + self._past) / self._approach_step)
        k = (step - approach_steps + 1).clamp(0, self._closing_steps)
        action = torch.zeros(len(plan), ACTION_SIZE)
        approaching = step < approach_steps
        per_step = (length + self._past) / approach_steps / TRANSLATION_STEP
        direction = way / length.clamp_min(1e-6)[:, None]
        action[:, :3] = torch.where(approaching[:, None], direction * per_step[:, None], 0.0)
        action[:, 2] += (step >= approach_steps + self._closing_steps).float()  # lift: 2 mm a step
        opened, closed = plan[:, PLAN_OPENED], plan[:, PLAN_CLOSED]
        span = closed - opened
        offset = torch.minimum(span / self._rate, opened + span * (k / self._closing_steps)[:, None] - fingers)
        action[:, 6:] = torch.where(approaching[:, None], 0.0, offset / plan[:, PLAN_FINGER_STEP])
        return action.clamp_(-1.0, 1.0)
