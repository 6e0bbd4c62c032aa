"""Train the networks that ship with `vgn`: trials in simulation, then gradient steps.

    icub train grasp_generator=vgn --minutes 120
    python -m icub_grasp_generators.vgn.training --run-dir runs/vgn --minutes 120

`parallel_jaw` learns from trials of a floating gripper, as the original; `icub_hand` starts from it and learns from
trials of the robot's own hand, which also teach its classifier. Trials are files in the run folder, training is
checkpointed, and calling again with the same folder resumes where it was.
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

from icub_core.files import write_text_atomically
from icub_core.provenance import machine, versions
from icub_grasp_generators.vgn.checkpoints import restored_steps
from icub_grasp_generators.vgn.classifier_training import CLASSIFIER_CHECKPOINT, evaluate_classifier, fit_classifier
from icub_grasp_generators.vgn.generation import Trials, generate
from icub_grasp_generators.vgn.gripper_trials import GripperTrials
from icub_grasp_generators.vgn.hand_trials import HandTrials
from icub_grasp_generators.vgn.network import GRIPPER, HAND, Meaning, load_network, save_network
from icub_grasp_generators.vgn.network_training import evaluate, fit
from icub_grasp_generators.vgn.trials import TriedScene, read_trials

log = logging.getLogger(__name__)

Progress = Callable[[float, str], None]

MAX_BATCHES = 100_000


@dataclass(frozen=True)
class Part:
    """One of the two networks.

    Attributes:
        name: Of the weights.
        pose: What a voxel's rotation belongs to.
        trials: Makes the trials; called with the seed.
        data: What they are of.
        trial_share, step_share: Of the whole time.
    """

    name: str
    pose: str
    trials: Callable[[int], Trials]
    data: str
    trial_share: float
    step_share: float


GRIPPER_DATA = "random1000 (pybullet_data), resized for the hand"
HAND_DATA = "random1000 (pybullet_data), resized for the hand, and random cartons, cans, bottles and tools, half each"
PARTS = (
    Part("parallel_jaw", GRIPPER, GripperTrials, GRIPPER_DATA, 0.08, 0.14),
    Part("icub_hand", HAND, HandTrials, HAND_DATA, 0.50, 0.12),
)
CLASSIFIER_SHARE = 0.16
"""Of the whole time, for the grasp-quality classifier; it learns from the hand's trials."""


def train(run_dir: Path, seed: int, minutes: float = 60.0, progress: Progress = lambda share, text: None) -> None:
    """Make trials and train, or resume, until `minutes` in all are spent; writes weights and cards."""
    begun, seconds = 0.0, 60 * minutes
    start_from: Path | None = None
    for part in PARTS:
        scenes = _scenes(part, run_dir, seed, seconds, begun, progress)
        begun += part.trial_share
        told = _part_of(progress, begun, part.step_share)
        network = fit(part.name, part.pose, scenes, run_dir, seed, seconds * part.step_share, start_from, told)
        begun += part.step_share
        classifier = None
        if part.pose == HAND:
            told = _part_of(progress, begun, CLASSIFIER_SHARE)
            classifier = fit_classifier(scenes, run_dir, seed, seconds * CLASSIFIER_SHARE, told)
        start_from = run_dir / f"{part.name}.safetensors"
        save_network(start_from, network, Meaning(part.pose), classifier)
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

        generate(part.trials(seed), folder, MAX_BATCHES, start + budget - spent, told)
    return [scene for path in sorted(folder.glob("*.npz")) for scene in read_trials(path)]


def _write_card(part: Part, scenes: list[TriedScene], run_dir: Path, seed: int, minutes: float) -> None:
    """Write where the weights come from and how good they are on objects that were held out."""
    network, _, classifier = load_network(str(run_dir / f"{part.name}.safetensors"))
    tried, held = sum(len(s.success) for s in scenes), sum(int(s.success.sum()) for s in scenes)
    figures = evaluate(network, [s for s in scenes if s.held_out], part.pose)
    steps = {"network": restored_steps(run_dir / f"{part.name}.checkpoint.safetensors")}
    if classifier is not None:
        figures |= {f"judge_{key}": value for key, value in evaluate_classifier(classifier, scenes).items()}
        steps["judge"] = restored_steps(run_dir / CLASSIFIER_CHECKPOINT)
    card = {
        "name": part.name,
        "command": f"icub train grasp_generator=vgn --seed {seed} --minutes {minutes:g}",
        "seed": seed,
        "date": datetime.date.today().isoformat(),
        "data": f"{part.data}: {len(scenes)} scenes of {len({s.object_index for s in scenes})} objects, {tried} grasps "
        f"tried, {held} held; every tenth object held out",
        "machine": {**machine(), "system": platform.machine()},
        "versions": versions(),
        "minutes": minutes,
        "steps": steps,
        "figures": figures,
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
