"""A second network for the iCub's hand: how likely a hand pose holds the object, from what lies around that hand.

A voxel's quality is a mean over the ways the hand could come; this one looks at a single way. It sees the signed
distances of the view on a grid that is fixed to the hand, so that a shape between thumb and fingers looks the same
wherever it stands and from wherever the hand comes.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from icub_core.geometry import FloatArray
from icub_grasp_generators.vgn.range_view import RangeView

CELLS = (18, 14, 14)
CELL = 0.01
"""Cells of the grid along the hand's axes, and their edge in meters."""
_LOW = np.array([-0.06, -0.07, -0.04])
_REACH = 0.03
"""Meters at which distances are cut off."""
_HIGH = 0.10
"""Meters at which heights above the table are cut off."""
FACTS = 7

_grid = np.stack(np.meshgrid(*(np.arange(n) for n in CELLS), indexing="ij"), axis=-1)
_POINTS: FloatArray = (_LOW + (_grid.reshape(-1, 3) + 0.5) * CELL).astype(np.float64)


def around_hand(view: RangeView, T_world_hand: FloatArray) -> NDArray[np.float16]:
    """Return distances (C, 18, 14, 14) around hands at poses (C, 4, 4), -1..1: 1 is free, -1 is hidden or inside."""
    world = _POINTS @ np.swapaxes(T_world_hand[:, :3, :3], 1, 2) + T_world_hand[:, None, :3, 3]
    distance = view.distance(world.reshape(-1, 3)) / _REACH
    return np.clip(distance, -1.0, 1.0).astype(np.float16).reshape(-1, *CELLS)


def heights(T_world_hand: torch.Tensor, table_top: torch.Tensor) -> torch.Tensor:
    """Return heights (C, 18, 14, 14) of the grid above a table at `table_top` (C,), -1..1 at 10 cm.

    Args:
        T_world_hand: (C, 4, 4) float32.
        table_top: World height, meters.
    """
    points = torch.from_numpy(_POINTS).to(T_world_hand.dtype)
    z = T_world_hand[:, 2, :3] @ points.T + (T_world_hand[:, 2, 3] - table_top)[:, None]
    return (z / _HIGH).clamp(-1.0, 1.0).reshape(-1, *CELLS)


def facts_of(T_world_hand: FloatArray, center: FloatArray, table_top: FloatArray) -> NDArray[np.float32]:
    """Return (C, 7): the object's middle and the vertical in the hand's frame, and the height of that middle.

    Args:
        T_world_hand: (C, 4, 4).
        center: (C, 3) estimated middles of the objects, world.
        table_top: (C,) world heights.
    """
    R = T_world_hand[:, :3, :3]
    middle = np.einsum("cij,ci->cj", R, center - T_world_hand[:, :3, 3])
    return np.concatenate([middle / 0.1, R[:, 2, :], (center[:, 2] - table_top)[:, None] / 0.1], axis=1).astype(
        np.float32
    )


class GraspClassifier(nn.Module):
    """Three convolutions and two layers: 0.2 million parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv3d(2, 16, 5, stride=2, padding=2)
        self.conv2 = nn.Conv3d(16, 32, 3, padding=1)
        self.conv3 = nn.Conv3d(32, 32, 3, stride=2, padding=1)
        self.hidden = nn.Linear(32 * 5 * 4 * 4 + FACTS, 64)
        self.dropout = nn.Dropout(0.3)
        self.out = nn.Linear(64, 1)

    def forward(self, distances: torch.Tensor, heights: torch.Tensor, facts: torch.Tensor) -> torch.Tensor:
        """Return logits (C,) of holding.

        Args:
            distances: (C, 18, 14, 14).
            heights: (C, 18, 14, 14).
            facts: (C, 7).
        """
        x = torch.stack([distances, heights], dim=1)
        for conv in (self.conv1, self.conv2, self.conv3):
            x = functional.relu(conv(x))
        x = functional.relu(self.hidden(self.dropout(torch.cat([x.flatten(1), facts], dim=1))))
        return torch.as_tensor(self.out(self.dropout(x))[:, 0])

    @torch.inference_mode()
    def score(
        self, view: RangeView, T_world_hand: FloatArray, center: FloatArray, table_top: float
    ) -> NDArray[np.float64]:
        """Return how likely (C,) hands at poses (C, 4, 4) hold what is seen.

        Args:
            view: The object.
            T_world_hand: Of the right hand.
            center: (3,) estimated middle of the object.
            table_top: World height.
        """
        count = len(T_world_hand)
        top = np.full(count, table_top)
        facts = facts_of(T_world_hand, np.tile(center, (count, 1)), top)
        field = torch.from_numpy(around_hand(view, T_world_hand).astype(np.float32))
        T = torch.from_numpy(T_world_hand.astype(np.float32))
        logits = self(field, heights(T, torch.from_numpy(top.astype(np.float32))), torch.from_numpy(facts))
        return np.asarray(torch.sigmoid(logits).numpy(), dtype=np.float64)
