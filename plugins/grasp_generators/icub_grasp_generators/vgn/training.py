"""Train the two networks that ship with `vgn`: trials in simulation, then gradient steps.

    icub train grasp_generator=vgn --minutes 120
    python -m icub_grasp_generators.vgn.training --run-dir runs/vgn --minutes 120

`parallel_jaw` learns from trials of a floating gripper, as the original; `icub_hand` starts from it and learns from
trials of the robot's own hand. Trials are files in the run folder, training is checkpointed, and calling again with the
same folder goes on where it was.

Source: Breyer et al. 2020 for the losses. DIFF: the rate falls to zero along a cosine, and fields are drawn from
the trials' clouds, several a scene.
"""

from __future__ import annotations

import argparse
import datetime
import json
import logging
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch.nn import functional

from icub_core.errors import DataError
from icub_core.evaluation.results import machine, versions
from icub_core.files import write_atomically, write_text_atomically
from icub_grasp_generators.vgn.generation import Trials, generate
from icub_grasp_generators.vgn.gripper_trials import GripperTrials
from icub_grasp_generators.vgn.hand_trials import HandTrials
from icub_grasp_generators.vgn.network import GRIPPER, HAND, Meaning, VgnNetwork, load_network, save_network
from icub_grasp_generators.vgn.samples import Batch, Draw, collate, draw
from icub_grasp_generators.vgn.trials import TriedScene, read_trials

log = logging.getLogger(__name__)

Progress = Callable[[float, str], None]

SCENES_PER_STEP = 8
LEARNING_RATE = 2e-3
WIDTH_WEIGHT = 0.01
"""Of the squared error of the width in voxels (original)."""
CHECKPOINT_SECONDS = 60.0
LARGEST_GRADIENT = 5.0
VARIANTS = 6
"""Draws of each scene, kept; a step takes some of one's trials."""
MOST_BATCHES = 100_000

_TURN_ABOUT_Z = torch.tensor([0.0, 0.0, 1.0, 0.0])
"""Half a turn about a gripper's approach, xyzw: the same grasp with its fingers exchanged."""


@dataclass(frozen=True)
class Part:
    """One of the two networks.

    Attributes:
        name: Of the weights.
        pose: What a voxel's rotation belongs to.
        trials: Makes the trials; called with the seed.
        trial_share, step_share: Of the whole time.
    """

    name: str
    pose: str
    trials: Callable[[int], Trials]
    trial_share: float
    step_share: float


PARTS = (
    Part("parallel_jaw", GRIPPER, GripperTrials, 0.123, 0.167),
    Part("icub_hand", HAND, HandTrials, 0.528, 0.182),
)


def train(run_dir: Path, seed: int, minutes: float, progress: Progress) -> None:
    """Make trials and train, or go on with it, until `minutes` in all are spent; writes weights and cards."""
    begun = 0.0
    start_from: Path | None = None
    for part in PARTS:
        scenes = _scenes(part, run_dir, seed, 60 * minutes, begun, progress)
        begun += part.trial_share
        seconds = 60 * minutes * part.step_share
        fit(part, scenes, run_dir, seed, seconds, start_from, _part_of(progress, begun, part.step_share))
        begun += part.step_share
        start_from = run_dir / f"{part.name}.safetensors"
        _write_card(part, scenes, run_dir, seed, minutes)


def _part_of(progress: Progress, begun: float, share: float) -> Progress:
    return lambda fraction, text: progress(begun + share * fraction, text)


def _scenes(part: Part, run_dir: Path, seed: int, seconds: float, begun: float, progress: Progress) -> list[TriedScene]:
    """Try grasps until the part's share of the time is spent, counting earlier calls; returns all scenes."""
    folder, clock = run_dir / f"{part.name}_trials", run_dir / f"{part.name}_trials.seconds.json"
    spent = float(json.loads(clock.read_text())) if clock.exists() else 0.0
    budget = part.trial_share * seconds
    if spent < budget or not list(folder.glob("*.npz")):
        start = time.monotonic()

        def told(_: float, text: str) -> None:
            used = spent + time.monotonic() - start
            write_text_atomically(clock, json.dumps(used))
            progress(begun + part.trial_share * min(used / budget, 1.0), f"{part.name}: {text}")

        generate(part.trials(seed), folder, MOST_BATCHES, start + budget - spent, told)
    return [scene for path in sorted(folder.glob("*.npz")) for scene in read_trials(path)]


def loss_of(out: torch.Tensor, batch: Batch, pose: str) -> torch.Tensor:
    """Return the mean loss of network outputs (G, 6): cross-entropy, and for held trials rotation and width.

    Rotations that differ by half a turn about the approach are the same grasp of a gripper, but not of a hand.
    """
    quality = functional.binary_cross_entropy_with_logits(out[:, 0], batch.label)
    turned = functional.normalize(out[:, 1:5], dim=1)
    cosine = (turned * batch.quaternion).sum(dim=1).abs()
    rotation, width = 1.0 - cosine, torch.zeros_like(cosine)
    if pose == GRIPPER:
        other = _times(batch.quaternion, _TURN_ABOUT_Z)
        rotation = torch.minimum(rotation, 1.0 - (turned * other).sum(dim=1).abs())
        width = WIDTH_WEIGHT * (out[:, 5] - batch.width) ** 2
    return quality + (batch.label * (rotation + width)).mean()


def _times(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Multiply quaternions (G, 4) and (4,), xyzw."""
    xyz = a[:, 3:] * b[:3] + b[3] * a[:, :3] + torch.linalg.cross(a[:, :3], b[:3].expand(len(a), 3))
    return torch.cat([xyz, a[:, 3:] * b[3] - (a[:, :3] * b[:3]).sum(dim=1, keepdim=True)], dim=1)


def fit(
    part: Part,
    scenes: list[TriedScene],
    run_dir: Path,
    seed: int,
    seconds: float,
    start_from: Path | None,
    progress: Progress,
) -> None:
    """Do gradient steps on the scenes that are not held out for `seconds` over all calls; writes the weights last."""
    taught = [s for s in scenes if not s.held_out and len(s.success)]
    if not taught:
        raise DataError(f"{part.name}: no trials to learn from; give it more time")
    torch.manual_seed(seed)
    network = VgnNetwork() if start_from is None else load_network(str(start_from))[0]
    network.requires_grad_(True).train()
    optimiser = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
    checkpoint = run_dir / f"{part.name}.checkpoint.safetensors"
    step, spent = _restore(checkpoint, network, optimiser)
    fields = Fields(taught, part.pose, seed)
    begun = saved = time.monotonic()
    running = np.nan
    while (used := spent + time.monotonic() - begun) < seconds or step == 0:
        share = min(used / seconds, 1.0)
        for group in optimiser.param_groups:
            group["lr"] = LEARNING_RATE * 0.5 * (1 + np.cos(np.pi * share))
        batch = fields.batch(step)
        loss = loss_of(network.at_voxels(batch.tsdf, batch.scene, batch.index), batch, part.pose)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), LARGEST_GRADIENT)
        optimiser.step()
        step += 1
        running = loss.item() if np.isnan(running) else 0.98 * running + 0.02 * loss.item()
        progress(share, f"{part.name}: step {step}, loss {running:.3f}")
        if time.monotonic() - saved > CHECKPOINT_SECONDS:
            _save(checkpoint, network, optimiser, step, used)
            saved = time.monotonic()
    _save(checkpoint, network, optimiser, step, max(spent, used))
    network.eval()
    save_network(run_dir / f"{part.name}.safetensors", network, Meaning(part.pose))


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


def _save(path: Path, network: VgnNetwork, optimiser: torch.optim.Optimizer, step: int, spent: float) -> None:
    tensors = {f"network.{k}": v.detach().contiguous() for k, v in network.state_dict().items()}
    for i, entry in optimiser.state_dict()["state"].items():
        tensors |= {f"adam.{i}.{k}": v.detach().clone().contiguous() for k, v in entry.items()}
    tensors |= {"step": torch.tensor(step), "spent": torch.tensor(spent)}
    write_atomically(path, lambda temporary: save_file(tensors, temporary))


def _restore(path: Path, network: VgnNetwork, optimiser: torch.optim.Optimizer) -> tuple[int, float]:
    if not path.exists():
        return 0, 0.0
    tensors = load_file(path)
    network.load_state_dict({k.removeprefix("network."): v for k, v in tensors.items() if k.startswith("network.")})
    state = optimiser.state_dict()
    for key, value in tensors.items():
        if key.startswith("adam."):
            _, number, name = key.split(".", 2)
            state["state"].setdefault(int(number), {})[name] = value
    optimiser.load_state_dict(state)
    return int(tensors["step"]), float(tensors["spent"])


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
        turned = functional.normalize(out[:, 1:5], dim=1)
        cosine = (turned * batch.quaternion).sum(dim=1).abs()
        if pose == GRIPPER:
            cosine = torch.maximum(cosine, (turned * _times(batch.quaternion, _TURN_ABOUT_Z)).sum(dim=1).abs())
        logits.append(out[:, 0].numpy())
        labels.append(batch.label.numpy() > 0.5)
        angles.append(np.degrees(2 * np.arccos(np.clip(cosine.numpy(), 0.0, 1.0)))[labels[-1]])
    score, label = np.concatenate(logits), np.concatenate(labels)
    figures = {"trials": float(len(label)), "held": float(label.mean())}
    if label.any() and not label.all():
        ranks = np.argsort(np.argsort(score)) + 1.0
        won, lost = int(label.sum()), int((~label).sum())
        figures["auc"] = float((ranks[label].sum() - won * (won + 1) / 2) / (won * lost))
        figures["accuracy"] = float(((score[label] > 0).mean() + (score[~label] <= 0).mean()) / 2)
    if label.any():
        figures["rotation_error_deg"] = float(np.concatenate(angles).mean())
    return figures


def _write_card(part: Part, scenes: list[TriedScene], run_dir: Path, seed: int, minutes: float) -> None:
    """Write where the weights come from and how good they are on objects that were held out."""
    network, _ = load_network(str(run_dir / f"{part.name}.safetensors"))
    tried, held = sum(len(s.success) for s in scenes), sum(int(s.success.sum()) for s in scenes)
    card = {
        "name": part.name,
        "command": f"icub train grasp_generator=vgn --seed {seed} --minutes {minutes:g}",
        "seed": seed,
        "date": datetime.date.today().isoformat(),
        "data": f"random1000 (pybullet_data), resized for the hand: {len(scenes)} scenes of "
        f"{len({s.object_index for s in scenes})} objects, {tried} grasps tried, {held} held; "
        "every tenth object held out",
        "machine": {**machine(), "system": platform.machine()},
        "versions": versions(),
        "minutes": minutes,
        "steps": int(load_file(run_dir / f"{part.name}.checkpoint.safetensors")["step"]),
        "figures": evaluate(network, [s for s in scenes if s.held_out], part.pose),
    }
    write_text_atomically(run_dir / f"{part.name}.json", json.dumps(card, indent=2) + "\n")


def main() -> None:
    """Run the training without the rest of the commands."""
    parser = argparse.ArgumentParser(description="Train the networks of the grasp generator vgn.")
    parser.add_argument("--run-dir", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=120.0)
    options = parser.parse_args()
    options.run_dir.mkdir(parents=True, exist_ok=True)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    told = [0.0]

    def progress(share: float, text: str) -> None:
        if time.monotonic() - told[0] > 10.0:
            told[0] = time.monotonic()
            log.info("%5.1f %%  %s", 100 * share, text)

    train(options.run_dir, options.seed, options.minutes, progress)


if __name__ == "__main__":
    main()
