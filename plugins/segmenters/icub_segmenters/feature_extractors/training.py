"""Pre-training of the compact Mask R-CNN on two CPU cores, resumable.

Each worker is a process with one thread; gradients are averaged over gloo. On two cores this is faster than one
process with two threads (22 against 17 images/s on quiet cores). The learning rate follows a cosine of the share of
the budget (images or minutes) that is used up.
"""

from __future__ import annotations

import argparse
import copy
import json
import logging
import math
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import Empty
from typing import Any, Protocol

import numpy as np
import torch
import torch.distributed
import torch.multiprocessing
from numpy.typing import NDArray
from torch import nn

from icub_core.errors import CheckpointError
from icub_core.files import write_text_atomically
from icub_core.provenance import machine, versions
from icub_core.registry import load
from icub_segmenters.feature_extractors.compact import CompactMaskRcnn
from icub_segmenters.feature_extractors.compact_regions import CENTER, SCALE, calibrate
from icub_segmenters.feature_extractors.evaluation import feature_task_precision, proposal_recall
from icub_segmenters.feature_extractors.network import CompactNetwork
from icub_segmenters.mask_geometry import boxes_of_masks
from icub_support.weights import adam_state, load_adam_state, part, read_tensors, with_prefix, write_card, write_tensors

log = logging.getLogger(__name__)

BATCH = 4
LEARNING_RATE = 1.2e-3
WEIGHT_DECAY = 0.02
CLIP_NORM = 10.0
WARM_UP_STEPS = 300
EMA_DECAY = 0.998
CHECKPOINT_SECONDS = 120.0
CHECKPOINT = "checkpoint.safetensors"

Progress = Callable[[dict[str, float]], None]


class _Sample(Protocol):
    """What a training image must offer."""

    rgb: NDArray[np.uint8]
    instances: NDArray[np.uint8]
    labels: NDArray[np.int64]


class TrainingTask(Protocol):
    """A source of training images; it is sent to the worker processes, so it must be picklable."""

    @property
    def label_count(self) -> int:
        """Number of classes; labels go from 1 to this number."""

    def sample(self, rng: np.random.Generator) -> _Sample:
        """One augmented image with at least one object."""


@dataclass(frozen=True)
class Budget:
    """How long to train: by images (repeatable) or by minutes of wall clock (the default on a laptop)."""

    images: int | None = None
    minutes: float | None = None

    def share(self, images: int, seconds: float) -> float:
        """Used share of the budget, 0 to 1."""
        if self.images is not None:
            return min(1.0, images / self.images)
        assert self.minutes is not None
        return min(1.0, seconds / (60 * self.minutes))


@dataclass
class TrainingState:
    """Where a training stands."""

    seed: int
    workers: int
    label_count: int
    step: int = 0
    images: int = 0
    seconds: float = 0.0


def learning_rate(share: float, step: int) -> float:
    """Cosine from LEARNING_RATE to 1 % of it, with a linear warm-up."""
    cosine = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share))
    return LEARNING_RATE * cosine * min(1.0, (step + 1) / WARM_UP_STEPS)


def make_batch(
    task: TrainingTask, rng: np.random.Generator, size: int
) -> tuple[torch.Tensor, list[dict[str, torch.Tensor]]]:
    """Draw images (size, 3, H, W) uint8 and their targets (boxes, labels, masks)."""
    images, targets = [], []
    for _ in range(size):
        sample = task.sample(rng)
        instances = torch.from_numpy(sample.instances)
        masks = (instances[None] == torch.arange(1, len(sample.labels) + 1, dtype=torch.uint8)[:, None, None]).byte()
        images.append(torch.from_numpy(sample.rgb).permute(2, 0, 1))
        labels = torch.from_numpy(sample.labels)
        targets.append(
            {"boxes": boxes_of_masks(masks.bool(), torch.zeros(len(masks), 4)), "labels": labels, "masks": masks}
        )
    return torch.stack(images), targets


class _Trainer:
    """One worker's network, optimizer and average; worker 0 also keeps the checkpoint."""

    def __init__(self, state: TrainingState) -> None:
        torch.manual_seed(state.seed)
        self.state = state
        self.network = CompactNetwork(state.label_count).to(memory_format=torch.channels_last).train()
        self.average: nn.Module = copy.deepcopy(self.network).eval().requires_grad_(False)
        self.parameters = dict(self.network.named_parameters())
        self.optimizer = torch.optim.AdamW(
            self.parameters.values(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY, fused=True
        )

    def gradients(self, task: TrainingTask, rank: int) -> dict[str, float]:
        """Compute this worker's gradients for the present step."""
        # seeds per step: a resumed training draws what the uninterrupted one would have drawn
        seed = [self.state.seed, rank, self.state.step]
        torch.manual_seed(int(np.random.SeedSequence(seed).generate_state(1)[0]))
        images, targets = make_batch(task, np.random.default_rng(seed), BATCH)
        losses = self.network.losses(images, targets)
        self.optimizer.zero_grad(set_to_none=True)
        sum(losses.values()).backward()  # type: ignore[union-attr]
        return {name: float(value.detach()) for name, value in losses.items()}

    def exchange(self, seconds: float, rank: int) -> float:
        """Average gradients over the workers; return the seconds that worker 0 reports, equal everywhere."""
        grads = [p.grad if p.grad is not None else torch.zeros_like(p) for p in self.parameters.values()]
        # in the order of memory: gradients of channels_last weights would be gathered element by element otherwise
        views = [g.as_strided((g.numel(),), (1,)) for g in grads]
        flat = torch.cat([*views, torch.tensor([seconds if rank == 0 else 0.0])])
        if self.state.workers > 1:
            torch.distributed.all_reduce(flat)
        seconds = float(flat[-1])
        flat = flat[:-1] / self.state.workers
        if not torch.isfinite(flat).all():
            raise CheckpointError(f"gradients are not finite at step {self.state.step}; the last checkpoint is kept")
        start = 0
        for parameter, grad, view in zip(self.parameters.values(), grads, views, strict=True):
            view.copy_(flat[start : start + view.numel()])
            parameter.grad = grad
            start += view.numel()
        return seconds

    def apply(self, rate: float, rank: int) -> None:
        """Take the optimizer's step and update the moving average of weights and statistics."""
        nn.utils.clip_grad_norm_(list(self.parameters.values()), CLIP_NORM)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.optimizer.step()
        if rank == 0:
            keep = min(EMA_DECAY, (1 + self.state.step) / (10 + self.state.step))
            with torch.no_grad():
                for mine, new in zip(
                    self.average.state_dict().values(), self.network.state_dict().values(), strict=True
                ):
                    if mine.is_floating_point():
                        mine.lerp_(new, 1 - keep)
                    else:
                        mine.copy_(new)

    def save(self, path: Path) -> None:
        """Write everything needed to resume, atomically."""
        tensors = with_prefix("network", self.network.state_dict()) | with_prefix("average", self.average.state_dict())
        names = list(self.parameters)
        for key, value in adam_state(self.optimizer).items():
            number, _, moment = key.partition(".")
            tensors[f"adam.{moment}.{names[int(number)]}"] = value
        write_tensors(path, tensors, {"state": json.dumps(asdict(self.state))})

    def load(self, path: Path) -> None:
        """Resume from a checkpoint.

        Raises:
            CheckpointError: Unreadable, or of another seed, number of workers or number of classes.
        """
        tensors, state = read_checkpoint(path)
        for field in ("seed", "workers", "label_count"):
            if getattr(state, field) != getattr(self.state, field):
                raise CheckpointError(
                    f"{path} was trained with {field}={getattr(state, field)}, asked for {getattr(self.state, field)}; "
                    "name another run folder"
                )
        self.state = state
        self.network.load_state_dict(part(tensors, "network"))
        self.average.load_state_dict(part(tensors, "average"))
        numbers = {name: number for number, name in enumerate(self.parameters)}
        memory = {}
        for key, value in part(tensors, "adam").items():
            moment, _, name = key.partition(".")
            memory[f"{numbers[name]}.{moment}"] = value
        load_adam_state(self.optimizer, memory)


def read_checkpoint(path: Path) -> tuple[dict[str, torch.Tensor], TrainingState]:
    """Read a training checkpoint.

    Raises:
        CheckpointError: When it is missing or cannot be read.
    """
    tensors, header = read_tensors(path)
    try:
        return tensors, TrainingState(**json.loads(header["state"]))
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path} is not a checkpoint of this training ({error})") from error


def export(checkpoint: Path, weights: Path, task: TrainingTask, images: int = 64) -> TrainingState:
    """Write the averaged weights of a checkpoint as half-precision safetensors, ready to ship.

    Args:
        checkpoint: What `fit` returned.
        weights: File to write.
        task: Gives the images on which the scales of the region features are measured.
        images: Number of those.
    """
    tensors, state = read_checkpoint(checkpoint)
    average = part(tensors, "average")
    network = CompactNetwork(state.label_count)
    network.load_state_dict(average)
    rng = np.random.default_rng([state.seed, 7])
    samples = [torch.from_numpy(task.sample(rng).rgb).permute(2, 0, 1) for _ in range(images)]
    center, scale = calibrate(network.eval(), samples)
    kept = {k: v.half() for k, v in average.items() if not k.endswith("num_batches_tracked")}
    kept |= {CENTER: center, SCALE: scale}
    write_tensors(weights, kept, {"architecture": "compact", "classes": str(state.label_count)})
    return state


def _work(rank: int, task: TrainingTask, folder: Path, state: TrainingState, budget: Budget, news: Any) -> None:
    """What a worker process does."""
    torch.set_num_threads(1)
    if state.workers > 1:
        torch.distributed.init_process_group(
            "gloo", init_method=f"file://{folder / f'meeting_{os.getppid()}'}", rank=rank, world_size=state.workers
        )
    trainer = _Trainer(state)
    path = folder / CHECKPOINT
    if path.exists():
        trainer.load(path)
    state = trainer.state
    begun, before, saved = time.monotonic(), state.seconds, time.monotonic()
    while (share := budget.share(state.images, state.seconds)) < 1.0:
        losses = trainer.gradients(task, rank)
        state.seconds = trainer.exchange(before + time.monotonic() - begun, rank)
        trainer.apply(learning_rate(share, state.step), rank)
        state.step += 1
        state.images += BATCH * state.workers
        if rank == 0:
            if state.step % 10 == 0:
                news.put({"share": share, "images": state.images, "seconds": state.seconds, **losses})
            if time.monotonic() - saved > CHECKPOINT_SECONDS:
                trainer.save(path)
                saved = time.monotonic()
    if rank == 0:
        trainer.save(path)
    if state.workers > 1:
        torch.distributed.barrier()
        torch.distributed.destroy_process_group()


def fit(
    task: TrainingTask,
    folder: Path,
    budget: Budget,
    seed: int = 0,
    workers: int = 2,
    progress: Progress | None = None,
) -> Path:
    """Train, or resume a training, in a run folder.

    Args:
        task: Source of images.
        folder: Run folder; holds the checkpoint.
        budget: Images or minutes in all, over all resumptions.
        seed: Seed of weights and samples.
        workers: Processes of one thread each.
        progress: Called in this process with share, images, seconds and the losses of one batch.

    Returns:
        Path of the final checkpoint.

    Raises:
        CheckpointError: When an existing checkpoint does not fit, or a worker failed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    state = TrainingState(seed, workers, task.label_count)
    if (folder / CHECKPOINT).exists():
        found = read_checkpoint(folder / CHECKPOINT)[1]
        log.info("resuming after %d images in %s", found.images, folder)
    context = torch.multiprocessing.get_context("spawn")
    news = context.Queue()
    crew = [
        context.Process(target=_work, args=(rank, task, folder, state, budget, news), daemon=True)
        for rank in range(workers)
    ]
    for worker in crew:
        worker.start()
    try:
        while any(worker.is_alive() for worker in crew):
            if any(worker.exitcode for worker in crew):
                break  # the others wait for a dead worker's gradients
            try:
                report = news.get(timeout=1.0)
            except Empty:
                continue
            if progress is not None:
                progress(report)
    finally:
        failed = any(worker.exitcode for worker in crew)
        for worker in crew:
            if worker.is_alive() and failed:
                worker.terminate()
            worker.join(timeout=10)
            if worker.is_alive():
                worker.terminate()
        (folder / f"meeting_{os.getpid()}").unlink(missing_ok=True)
    if failed:
        raise CheckpointError(f"a training process failed; the same command resumes from {folder / CHECKPOINT}")
    return folder / CHECKPOINT


TRAINING_SHARE = 0.93
"""Of the wall time that is left after rendering, this goes to training, the rest to export and evaluation."""


def _plan(run_dir: Path, minutes: float, spent: float) -> float:
    """Minutes of training, fixed when a run begins so that resuming does not bend its schedule."""
    path = run_dir / "plan.json"
    if not path.exists():
        planned = max(0.5 * minutes, TRAINING_SHARE * (minutes - spent))
        write_text_atomically(path, json.dumps({"asked_minutes": minutes, "training_minutes": planned}))
    plan = json.loads(path.read_text())
    if plan["asked_minutes"] != minutes:
        raise CheckpointError(f"{run_dir} was begun with {plan['asked_minutes']:g} minutes, asked for {minutes:g}")
    return float(plan["training_minutes"])


def train(
    run_dir: Path,
    seed: int,
    minutes: float = 75.0,
    progress: Callable[[float, str], None] = lambda share, text: None,
    data: Path | None = None,
) -> Path:
    """Render the FEATURE-TASK, train on it, export and evaluate: what ``icub train feature_extractor=compact`` does.

    Args:
        run_dir: Folder for checkpoint, weights (``compact.safetensors``) and card (``compact.json``).
        seed: Seed of weights, samples and scenes.
        minutes: Wall time in all.
        progress: Called with the finished share and a short text.
        data: Folder of the rendered frames; None: below the user's cache folder.

    Returns:
        Path of the weights.
    """
    begun = time.monotonic()
    dataset: Any = load("dataset", "feature_task")
    frames: Any = dataset(path=data, split="train", seed=seed)
    unseen: Any = dataset(path=data, split="validation", seed=seed)
    for split in (frames, unseen):
        split.prepare(lambda ready, wanted: progress(0.0, f"rendering {ready}/{wanted}"))
    budget = Budget(minutes=_plan(run_dir, minutes, (time.monotonic() - begun) / 60))

    def report(news: dict[str, float]) -> None:
        losses = " ".join(f"{name} {news[name]:.2f}" for name in ("class", "box", "mask"))
        progress(TRAINING_SHARE * news["share"], f"{int(news['images'])} images, {losses}")

    checkpoint = fit(frames, run_dir, budget, seed, progress=report)
    weights = run_dir / "compact.safetensors"
    progress(TRAINING_SHARE, "exporting")
    state = export(checkpoint, weights, frames)
    extractor, rest = CompactMaskRcnn(str(weights)), 1 - TRAINING_SHARE
    figures = feature_task_precision(
        extractor, unseen, len(unseen), lambda s: progress(TRAINING_SHARE + 0.5 * rest * s, "evaluating classes")
    ) | proposal_recall(
        extractor, unseen, len(unseen), lambda s: progress(1 - 0.5 * rest * (1 - s), "evaluating proposals")
    )
    command = f"icub train feature_extractor=compact --seed {seed} --minutes {minutes:g}"
    write_card(run_dir / "compact.json", card_of(command, state, len(frames), len(unseen), figures))
    return weights


def card_of(command: str, state: TrainingState, frames: int, unseen: int, figures: dict[str, float]) -> dict[str, Any]:
    """Return the card of weights: how to make them again, from what, how long it took, and how good they are.

    Args:
        command: Line to type.
        state: At the end of training.
        frames: Training frames.
        unseen: Frames that were evaluated.
        figures: From `evaluation`.
    """
    return {
        "name": "compact",
        "command": command,
        "seed": state.seed,
        "data": f"FEATURE-TASK: {frames} rendered frames, {state.label_count} classes, copy-paste on the fly",
        "images_seen": state.images,
        "training_seconds": round(state.seconds),
        "machine": machine(),
        "versions": versions(),
        "figures": {f"feature_task.{key}": round(value, 4) for key, value in figures.items()},
        "figures_n": unseen,
        "note": "",
        "license": "BSD-3-Clause",
    }


def main(arguments: list[str] | None = None) -> None:
    """Run ``python -m icub_segmenters.feature_extractors.training``: the same with a folder for the frames."""
    parser = argparse.ArgumentParser(description="Pre-train the compact feature extractor.")
    parser.add_argument("run_dir", type=Path)
    parser.add_argument("--minutes", type=float, default=75.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--data", type=Path, help="folder of the rendered frames")
    options = parser.parse_args(arguments)
    from rich.console import Console

    console = Console()
    options.run_dir.mkdir(parents=True, exist_ok=True)
    with console.status("pre-training") as status:
        weights = train(
            options.run_dir,
            options.seed,
            options.minutes,
            lambda share, text: status.update(f"{100 * share:.1f} % {text}"),
            options.data,
        )
    console.print(f"weights: {weights}")


if __name__ == "__main__":
    main()
