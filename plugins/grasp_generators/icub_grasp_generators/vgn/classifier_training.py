"""Train the grasp-quality classifier on the hand's trials: every trial as each of its scene's views shows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from icub_core.data import PointCloud
from icub_core.errors import DataError
from icub_grasp_generators.clouds import center_of, thin
from icub_grasp_generators.vgn.classifier import GraspClassifier, around_hand, facts_of, heights
from icub_grasp_generators.vgn.descent import descend
from icub_grasp_generators.vgn.figures import area_under_curve
from icub_grasp_generators.vgn.palm import from_palm
from icub_grasp_generators.vgn.samples import MAX_POINTS, NOISE
from icub_grasp_generators.vgn.trials import TriedScene
from icub_grasp_generators.vgn.volume import Volume

CLASSIFIER_CHECKPOINT = "judge.checkpoint.safetensors"
BATCH = 64
LEARNING_RATE = 1e-3
WEIGHT_DECAY = 1e-2
CHECKPOINT_SECONDS = 30.0


@dataclass(frozen=True, eq=False)
class Cases:
    """Trials as the grasp-quality classifier sees them.

    Attributes:
        distances: (N, 18, 14, 14) float16.
        T_world_hand: (N, 4, 4) float32.
        table_top: (N,) float32.
        facts: (N, 7) float32.
        label: (N,) float32, 1 where the object was held.
        scene: (N,) which scene; the views of one follow each other.
    """

    distances: NDArray[np.float16]
    T_world_hand: NDArray[np.float32]
    table_top: NDArray[np.float32]
    facts: NDArray[np.float32]
    label: NDArray[np.float32]
    scene: NDArray[np.intp]

    def inputs(self, part: NDArray[np.intp]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return what the network takes for some of the cases."""
        T, top = torch.from_numpy(self.T_world_hand[part]), torch.from_numpy(self.table_top[part])
        distances = torch.from_numpy(self.distances[part].astype(np.float32))
        return distances, heights(T, top), torch.from_numpy(self.facts[part])


def cases_of(scenes: list[TriedScene], seed: int, progress: Callable[[float], None] = lambda _: None) -> Cases:
    """Look at every trial from every view of its scene. Raises DataError when there is none."""
    parts: list[Cases] = []
    for number, scene in enumerate(scenes):
        rng = np.random.default_rng([seed, number])
        seen = (_seen(scene, view, number, rng) for view in scene.views if len(scene.success))
        parts += [cases for cases in seen if cases is not None]
        progress(number / len(scenes))
    if not parts:
        raise DataError("the grasp-quality classifier of hand poses has no trials to learn from; give it more time")
    return Cases(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Cases)))


def _seen(scene: TriedScene, view: PointCloud, number: int, rng: np.random.Generator) -> Cases | None:
    """Return the trials of a scene as one view shows them; None where it shows next to nothing."""
    points = thin(view.points, MAX_POINTS)
    points = points + rng.normal(0.0, NOISE, points.shape)
    try:
        center = center_of(points, scene.table_top)
        cloud = PointCloud(points, viewpoint=view.viewpoint)
        seen = Volume.around(center, scene.table_top).range_view(cloud)
    except DataError:
        return None
    T, count = from_palm(scene.poses), len(scene.poses)
    top = np.full(count, scene.table_top)
    return Cases(
        around_hand(seen, T),
        T.astype(np.float32),
        top.astype(np.float32),
        facts_of(T, np.tile(center, (count, 1)), top),
        scene.success.astype(np.float32),
        np.full(count, number),
    )


def fit_classifier(
    scenes: list[TriedScene], run_dir: Path, seed: int, seconds: float, progress: Callable[[float, str], None]
) -> GraspClassifier:
    """Do gradient steps on the scenes that are not held out for `seconds` over all calls."""
    torch.manual_seed(seed)
    classifier = GraspClassifier()
    optimizer = torch.optim.AdamW(classifier.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    taught = [scene for scene in scenes if not scene.held_out]
    cases = cases_of(taught, seed, lambda share: progress(0.0, f"judge: looking at trials, {share:.0%}"))

    def loss_of_step(step: int) -> torch.Tensor:
        part = np.random.default_rng([seed, step]).integers(len(cases.label), size=BATCH)
        logits = classifier(*cases.inputs(part))
        return functional.binary_cross_entropy_with_logits(logits, torch.from_numpy(cases.label[part]))

    descend(
        classifier.train(),
        optimizer,
        run_dir / CLASSIFIER_CHECKPOINT,
        seconds,
        loss_of_step,
        lambda share, text: progress(share, f"judge: {text}"),
        save_every=CHECKPOINT_SECONDS,
    )
    return classifier.eval().requires_grad_(False)


@torch.inference_mode()
def evaluate_classifier(classifier: GraspClassifier, scenes: list[TriedScene], seed: int = 0) -> dict[str, float]:
    """Compare a grasp-quality classifier with the trials of scenes that were held out.

    Returns:
        `trials` (each as often as it has views), `held` (share), `auc`, and `held_best`: the share of views in which
        the trial scored best had held.
    """
    held_out = [scene for scene in scenes if scene.held_out]
    if not any(len(scene.success) for scene in held_out):
        return {"trials": 0.0}
    cases = cases_of(held_out, seed)
    pieces = np.array_split(np.arange(len(cases.label)), 1 + len(cases.label) // 256)
    score = torch.cat([classifier(*cases.inputs(part)) for part in pieces]).numpy()
    label = cases.label > 0.5
    figures = {"trials": float(len(label)), "held": float(label.mean())}
    if label.any() and not label.all():
        figures["auc"] = area_under_curve(score, label)
    best = []
    for number in np.unique(cases.scene):
        own = np.flatnonzero(cases.scene == number)
        views = len(own) // len(held_out[number].success)
        best += [label[one[np.argmax(score[one])]] for one in np.split(own, views)]
    return figures | {"held_best": float(np.mean(best))}
