"""What the networks see: the grasping task's observation, re-expressed so that every entry is near the size of 1.

Nothing is added to the observation of thesis 12.3.1; positions become relative (the object center in the hand's frame),
the Euler angles become the first two columns of the rotation (no jump at 2 pi), finger lengths are divided by their
usual range. The thesis's networks take the raw entries.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from tensordict import TensorDictBase

from icub_core.errors import ConfigError
from icub_core.interfaces.task import Task

HAND_POSE, FINGERS, TOUCH, OBJECT_CENTER, VISUAL = "hand_pose", "fingers", "touch", "object_center", "visual"
NEEDED = (HAND_POSE, FINGERS, TOUCH, OBJECT_CENTER)
LENGTH = 0.1
"""Meters that become 1."""
STACK = 5
"""Vectors that `icub_support.flare.flare` makes of three images."""


@dataclass(frozen=True)
class Inputs:
    """Sizes and scales of a network's input.

    Attributes:
        low, high: Usual lowest and highest length of each of the hand's F actuators, rad.
        touch: T, number of fingertips.
        center: Middle of the area in which objects stand, world, meters.
        visual: E, features of one image; 0 for a network that sees none.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    touch: int
    center: tuple[float, float, float]
    visual: int = 0

    @classmethod
    def of(cls, task: Task) -> Inputs:
        """Return the inputs for a task, with its images where it shows any.

        Raises:
            ConfigError: The task lacks an observation that the networks need.
        """
        spec = task.observation_spec
        missing = [name for name in NEEDED if name not in spec.keys()]
        if missing:
            raise ConfigError(
                f"the policy needs the observation '{missing[0]}', which the task does not have; "
                f"known: {', '.join(sorted(str(key) for key in spec.keys()))}"
            )
        ranges = task.observation_range
        count = spec[FINGERS].shape[-1]
        low, high = ranges.get(FINGERS, (torch.zeros(count), torch.ones(count)))
        near, far = ranges.get(OBJECT_CENTER, (torch.zeros(3), torch.zeros(3)))
        middle = ((near + far) / 2).tolist()
        visual = spec[VISUAL].shape[-1] // STACK if VISUAL in spec.keys() else 0
        return cls(
            tuple(low.tolist()), tuple(high.tolist()), spec[TOUCH].shape[-1], (middle[0], middle[1], middle[2]), visual
        )

    @classmethod
    def read(cls, header: dict[str, Any]) -> Inputs:
        """Return the inputs that a weight file states; version 0.1 stated none, and knew one hand."""
        stated = header.get("inputs")
        if stated is None:
            return VERSION_0_1
        low, high, center = (tuple(float(v) for v in stated[name]) for name in ("low", "high", "center"))
        return cls(low, high, int(stated["touch"]), (center[0], center[1], center[2]), int(stated["visual"]))

    def header(self) -> dict[str, Any]:
        """Return what `read` reads, for JSON."""
        return asdict(self)

    @property
    def size(self) -> int:
        """Entries of the input: 15 + F + T + 5 E."""
        return self.without_images + STACK * self.visual

    @property
    def without_images(self) -> int:
        """Entries that do not come from images."""
        return 3 + 3 + 3 + 6 + len(self.low) + self.touch

    def check(self, task: Task, actions: int) -> None:
        """Raise ConfigError where networks of these inputs and so many actions cannot act in a task."""
        there = Inputs.of(task)
        own, offered = (len(self.low), self.touch, actions), (len(there.low), there.touch, task.action_spec.shape[-1])
        if own != offered:
            raise ConfigError(
                f"the policy's weights are of a hand with {own[0]} actuators and {own[1]} fingertips ({own[2]} "
                f"actions); the task's has {offered[0]} and {offered[1]} ({offered[2]} actions)"
            )
        if self.visual and self.visual != there.visual:
            raise other_images(self.visual, there.visual)

    def __call__(self, observation: TensorDictBase) -> torch.Tensor:
        """Return the network input (B, size) float32 of a batch of observations.

        Raises:
            ConfigError: The network sees images and the observation has none, or others.
        """
        pose, center = observation[HAND_POSE], observation[OBJECT_CENTER]
        c, s = torch.cos(pose[:, 3:]), torch.sin(pose[:, 3:])
        cy, cp, cr = c.unbind(1)
        sy, sp, sr = s.unbind(1)
        # columns of Rx(roll) Ry(pitch) Rz(yaw)
        x_axis = torch.stack([cp * cy, cr * sy + sr * sp * cy, sr * sy - cr * sp * cy], dim=1)
        y_axis = torch.stack([-cp * sy, cr * cy - sr * sp * sy, sr * cy + cr * sp * sy], dim=1)
        z_axis = torch.stack([sp, -sr * cp, cr * cp], dim=1)
        offset = center - pose[:, :3]
        in_hand = torch.stack([(offset * axis).sum(1) for axis in (x_axis, y_axis, z_axis)], dim=1)
        middle, low = pose.new_tensor(self.center), pose.new_tensor(self.low)
        parts = [
            (pose[:, :3] - middle) / LENGTH,
            (center - middle) / LENGTH,
            in_hand / LENGTH,
            x_axis,
            y_axis,
            (observation[FINGERS] - low) / (pose.new_tensor(self.high) - low) * 2 - 1,
            observation[TOUCH],
        ]
        if self.visual:
            images = observation[VISUAL] if VISUAL in observation.keys() else pose.new_zeros(len(pose), 0)
            if images.shape[1] != STACK * self.visual:
                raise other_images(self.visual, images.shape[1] // STACK)
            parts.append(images)
        return torch.cat(parts, dim=1)


VERSION_0_1 = Inputs(
    low=(0.0,) * 9,
    high=(1.05, 1.57, 1.57, 2.97, 1.57, 2.97, 1.57, 2.97, 4.36),
    touch=5,
    center=(-0.35, 0.0, 1.0),
)
"""Weight files of version 0.1 are of the iCub's hand with these numbers."""


def other_images(own: int, there: int) -> ConfigError:
    """Return the error for networks that see images of `own` features where the task offers `there`."""
    return ConfigError(
        f"the policy sees images of {own} features, the task offers {there}; "
        "expected task.visual and the feature extractor with which the policy learned"
    )


def with_images(inputs: Inputs, visual: int) -> Inputs:
    """Return the inputs with images of `visual` features behind what was there."""
    return replace(inputs, visual=visual)
