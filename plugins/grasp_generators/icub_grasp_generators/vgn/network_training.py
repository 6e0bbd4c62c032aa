"""Train the network of VGN on grasp trials.

Source: Breyer et al. 2020 for the losses. DIFF: the rate falls to zero along a cosine, and fields are drawn from
the trials' clouds, several a scene.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional

from icub_core.errors import DataError
from icub_grasp_generators.vgn.descent import descend
from icub_grasp_generators.vgn.figures import area_under_curve
from icub_grasp_generators.vgn.network import GRIPPER, VgnNetwork, load_network
from icub_grasp_generators.vgn.samples import Batch, Draw, collate, draw
from icub_grasp_generators.vgn.trials import TriedScene

SCENES_PER_STEP = 8
LEARNING_RATE = 2e-3
WIDTH_WEIGHT = 0.01
"""Of the squared error of the width in voxels (original)."""
CHECKPOINT_SECONDS = 60.0
MAX_GRADIENT = 5.0
VARIANTS = 6
"""Draws of each scene, kept; a step takes some of one's trials."""

_TURN_ABOUT_Z = torch.tensor([0.0, 0.0, 1.0, 0.0])
"""Half a turn about a gripper's approach, xyzw: the same grasp with its fingers exchanged."""


def loss_of(out: torch.Tensor, batch: Batch, pose: str) -> torch.Tensor:
    """Return the mean loss of network outputs (G, 6): cross-entropy, and for held trials rotation and width.

    Rotations that differ by half a turn about the approach are the same grasp of a gripper, but not of a hand.
    """
    quality = functional.binary_cross_entropy_with_logits(out[:, 0], batch.label)
    rotation = 1.0 - _agreement(out, batch, pose)
    width = torch.zeros_like(rotation)
    if pose == GRIPPER:
        width = WIDTH_WEIGHT * (out[:, 5] - batch.width) ** 2
    return quality + (batch.label * (rotation + width)).mean()


def _agreement(out: torch.Tensor, batch: Batch, pose: str) -> torch.Tensor:
    """Return cosines (G,) of half the angles between predicted and tried rotations, of two equal ones the larger."""
    turned = functional.normalize(out[:, 1:5], dim=1)
    cosine = (turned * batch.quaternion).sum(dim=1).abs()
    if pose == GRIPPER:
        cosine = torch.maximum(cosine, (turned * _times(batch.quaternion, _TURN_ABOUT_Z)).sum(dim=1).abs())
    return cosine


def _times(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Multiply quaternions (G, 4) and (4,), xyzw."""
    xyz = a[:, 3:] * b[:3] + b[3] * a[:, :3] + torch.linalg.cross(a[:, :3], b[:3].expand(len(a), 3))
    return torch.cat([xyz, a[:, 3:] * b[3] - (a[:, :3] * b[:3]).sum(dim=1, keepdim=True)], dim=1)


def fit(
    name: str,
    pose: str,
    scenes: list[TriedScene],
    run_dir: Path,
    seed: int,
    seconds: float,
    start_from: Path | None,
    progress: Callable[[float, str], None],
) -> VgnNetwork:
    """Do gradient steps on the scenes that are not held out for `seconds` over all calls.

    Args:
        name: Of the checkpoint.
        pose: What the trials' poses belong to.
        scenes: Of which those that are held out are left alone.
        run_dir: Where the checkpoint is.
        seed: Decides first weights and batches.
        seconds: For all calls together.
        start_from: Weights to begin with.
        progress: Told the finished share and the loss.

    Raises:
        DataError: No trials.
    """
    taught = [s for s in scenes if not s.held_out and len(s.success)]
    if not taught:
        raise DataError(f"{name}: no trials to learn from; give it more time")
    torch.manual_seed(seed)
    network = VgnNetwork() if start_from is None else load_network(str(start_from))[0]
    network.requires_grad_(True).train()
    optimizer = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
    fields = Fields(taught, pose, seed)

    def loss_of_step(step: int) -> torch.Tensor:
        batch = fields.batch(step)
        return loss_of(network.at_voxels(batch.tsdf, batch.scene, batch.index), batch, pose)

    descend(
        network,
        optimizer,
        run_dir / f"{name}.checkpoint.safetensors",
        seconds,
        loss_of_step,
        lambda share, text: progress(share, f"{name}: {text}"),
        save_every=CHECKPOINT_SECONDS,
        largest_gradient=MAX_GRADIENT,
    )
    network.eval()
    return network.requires_grad_(False)


class Fields:
    """Batches of a training; fields are drawn `VARIANTS` times a scene and kept.

    Args:
        scenes: To learn from.
        pose: What the trials' poses belong to.
        seed: With the number of a step, decides its batch.
    """

    def __init__(self, scenes: list[TriedScene], pose: str, seed: int) -> None:
        self._scenes, self._pose, self._seed = scenes, pose, seed
        self._known: dict[tuple[int, int], Draw | None] = {}

    def batch(self, step: int) -> Batch:
        """Return the batch of one step."""
        rng = np.random.default_rng([self._seed, step])
        draws: list[Draw] = []
        while len(draws) < SCENES_PER_STEP:
            drawn = self._drawn(int(rng.integers(len(self._scenes))), int(rng.integers(VARIANTS)))
            if drawn is not None:
                draws.append(drawn.balanced(rng))
        return collate(draws)

    def _drawn(self, scene: int, variant: int) -> Draw | None:
        key = (scene, variant)
        if key not in self._known:
            rng = np.random.default_rng([self._seed, *key])
            self._known[key] = draw(self._scenes[scene], self._pose, rng)
        return self._known[key]


@torch.no_grad()
def evaluate(network: VgnNetwork, scenes: list[TriedScene], pose: str, seed: int = 0) -> dict[str, float]:
    """Judge predictions at the trials of scenes that were held out, two draws a scene.

    Returns:
        `trials`, `held` (share), `accuracy` (balanced, at 0.5), `auc`, `rotation_error_deg` (mean over held trials).
    """
    rng = np.random.default_rng(seed)
    drawn = (draw(scene, pose, rng) for scene in 2 * scenes)
    draws = [d for d in drawn if d is not None]
    if not draws:
        return {"trials": 0.0}
    logits, labels, angles = [], [], []
    for start in range(0, len(draws), SCENES_PER_STEP):
        batch = collate(draws[start : start + SCENES_PER_STEP])
        out = network.at_voxels(batch.tsdf, batch.scene, batch.index)
        cosine = _agreement(out, batch, pose)
        logits.append(out[:, 0].numpy())
        labels.append(batch.label.numpy() > 0.5)
        angles.append(np.degrees(2 * np.arccos(np.clip(cosine.numpy(), 0.0, 1.0)))[labels[-1]])
    score, label = np.concatenate(logits), np.concatenate(labels)
    figures = {"trials": float(len(label)), "held": float(label.mean())}
    if label.any() and not label.all():
        figures["auc"] = area_under_curve(score, label)
        figures["accuracy"] = float(((score[label] > 0).mean() + (score[~label] <= 0).mean()) / 2)
    if label.any():
        figures["rotation_error_deg"] = float(np.concatenate(angles).mean())
    return figures
