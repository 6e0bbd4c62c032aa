"""What the networks see: the task's observation, re-expressed so that every entry is near the size of 1.

Nothing is added to the observation of thesis 12.3.1; positions become relative (the object center in the hand's frame),
the Euler angles become the first two columns of the rotation (no jump at 2 pi), finger lengths are divided by their
usual range. The thesis's networks take the raw entries.
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase

from icub_core.errors import ConfigError
from icub_tasks.grasping.spaces import FINGERS, HAND_POSE, OBJECT_CENTER, TOUCH, VISUAL

WORKSPACE_CENTER = (-0.35, 0.0, 1.0)
"""Middle of the area in which objects stand, world, meters."""
LENGTH = 0.1
"""Meters that become 1."""
FINGER_RANGES = (1.05, 1.57, 1.57, 2.97, 1.57, 2.97, 1.57, 2.97, 4.36)
"""Travel of the nine finger actuators, rad."""

PROPRIOCEPTIVE_SIZE = 3 + 3 + 3 + 6 + len(FINGER_RANGES) + 5
STACK = 5
"""Vectors that `flare` makes of three images."""


def visual_size(inputs: int) -> int:
    """Return F, the features of one image, of networks with so many inputs; 0 for those that see no image."""
    return (inputs - PROPRIOCEPTIVE_SIZE) // STACK


def other_pictures(inputs: int, there: int) -> ConfigError:
    """Return the error for networks of so many inputs where the task offers `there`."""
    return ConfigError(
        f"the policy sees images of {visual_size(inputs)} features, the task offers {visual_size(there)}; "
        "expected pipeline.grasp.visual and the feature extractor with which the policy learned"
    )


def features(observation: TensorDictBase, inputs: int | None = None) -> torch.Tensor:
    """Return the network input (B, 29) float32 of a batch of observations, or (B, 29 + 5 F) with a visual part.

    Args:
        observation: Of the task.
        inputs: What the network takes; a network that sees no image gets none. None: everything there is.

    Raises:
        ConfigError: The network sees images and the observation has none, or others.
    """
    pictures = observation[VISUAL] if VISUAL in observation.keys() and inputs != PROPRIOCEPTIVE_SIZE else None
    there = PROPRIOCEPTIVE_SIZE + (0 if pictures is None else pictures.shape[1])
    if inputs is not None and inputs != there:
        raise other_pictures(inputs, there)
    pose, center = observation[HAND_POSE], observation[OBJECT_CENTER]
    c, s = torch.cos(pose[:, 3:]), torch.sin(pose[:, 3:])
    cy, cp, cr = c.unbind(1)
    sy, sp, sr = s.unbind(1)
    x_axis = torch.stack([cp * cy, cr * sy + sr * sp * cy, sr * sy - cr * sp * cy], dim=1)  # Rx(roll) Ry(pitch) Rz(yaw)
    y_axis = torch.stack([-cp * sy, cr * cy - sr * sp * sy, sr * cy + cr * sp * sy], dim=1)
    z_axis = torch.stack([sp, -sr * cp, cr * cp], dim=1)
    offset = center - pose[:, :3]
    in_hand = torch.stack([(offset * axis).sum(1) for axis in (x_axis, y_axis, z_axis)], dim=1)
    middle = pose.new_tensor(WORKSPACE_CENTER)
    parts = [
        (pose[:, :3] - middle) / LENGTH,
        (center - middle) / LENGTH,
        in_hand / LENGTH,
        x_axis,
        y_axis,
        observation[FINGERS] / pose.new_tensor(FINGER_RANGES) * 2 - 1,
        observation[TOUCH],
    ]
    if pictures is not None:
        parts.append(pictures)
    return torch.cat(parts, dim=1)
