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
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn

from icub_core.errors import CheckpointError
from icub_segmenters.feature_extractors.network import CompactNetwork

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
        targets.append({"boxes": boxes_of(masks), "labels": labels, "masks": masks})
    return torch.stack(images), targets


def boxes_of(masks: torch.Tensor) -> torch.Tensor:
    """Tight boxes (N, 4) xyxy px of non-empty masks (N, H, W), the far edges exclusive."""
    rows, columns = masks.any(2), masks.any(1)
    height, width = rows.shape[1], columns.shape[1]
    y0, x0 = rows.byte().argmax(1), columns.byte().argmax(1)
    y1, x1 = height - rows.flip(1).byte().argmax(1), width - columns.flip(1).byte().argmax(1)
    return torch.stack([x0, y0, x1, y1], dim=1).float()


class _Trainer:
    """One worker's network, optimiser and average; worker 0 also keeps the checkpoint."""

    def __init__(self, state: TrainingState) -> None:
        torch.manual_seed(state.seed)
        self.state = state
        self.network = CompactNetwork(state.label_count).to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
        self.average: nn.Module = copy.deepcopy(self.network).eval().requires_grad_(False)
        self.parameters = dict(self.network.named_parameters())
        self.optimiser = torch.optim.AdamW(
            self.parameters.values(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY, fused=True
        )

    def gradients(self, task: TrainingTask, rank: int) -> dict[str, float]:
        """Compute this worker's gradients for the present step."""
        # seeds per step: a resumed training draws what the uninterrupted one would have drawn
        seed = [self.state.seed, rank, self.state.step]
        torch.manual_seed(int(np.random.SeedSequence(seed).generate_state(1)[0]))
        images, targets = make_batch(task, np.random.default_rng(seed), BATCH)
        losses = self.network.losses(images, targets)
        self.optimiser.zero_grad(set_to_none=True)
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
        """Take the optimiser's step and update the moving average of weights and statistics."""
        nn.utils.clip_grad_norm_(list(self.parameters.values()), CLIP_NORM)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        self.optimiser.step()
        if rank == 0:
            keep = min(EMA_DECAY, (1 + self.state.step) / (10 + self.state.step))
            with torch.no_grad():
                for mine, new in zip(self.average.state_dict().values(), self.network.state_dict().values(), strict=True):
                    if mine.is_floating_point():
                        mine.lerp_(new, 1 - keep)
                    else:
                        mine.copy_(new)

    # checkpoints ----------------------------------------------------------------------------------------------

    def save(self, path: Path) -> None:
        """Write everything needed to go on, atomically."""
        tensors = {f"network.{k}": v for k, v in self.network.state_dict().items()}
        tensors |= {f"average.{k}": v for k, v in self.average.state_dict().items()}
        for name, parameter in self.parameters.items():
            memory = self.optimiser.state.get(parameter, {})
            tensors |= {f"adam.{key}.{name}": value for key, value in memory.items()}
        write_safetensors(path, tensors, {"state": json.dumps(asdict(self.state))})

    def load(self, path: Path) -> None:
        """Go on from a checkpoint.

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
        parts: dict[str, dict[str, torch.Tensor]] = {"network": {}, "average": {}, "adam": {}}
        for key, value in tensors.items():
            part, name = key.split(".", 1)
            parts[part][name] = value
        self.network.load_state_dict(parts["network"])
        self.average.load_state_dict(parts["average"])
        for name, parameter in self.parameters.items():
            memory = {key: parts["adam"][f"{key}.{name}"] for key in ("step", "exp_avg", "exp_avg_sq")}
            # the moments get the memory layout of their weight, as the fused optimiser wants it
            self.optimiser.state[parameter] = {
                key: torch.empty_like(parameter).copy_(v).detach() if v.ndim else v for key, v in memory.items()
            }


def write_safetensors(path: Path, tensors: dict[str, torch.Tensor], metadata: dict[str, str]) -> None:
    """Write tensors atomically.

    Raises:
        CheckpointError: When the file cannot be written; an older file stays as it was.
    """
    scratch = path.with_suffix(f".{os.getpid()}.tmp")
    try:
        save_file({k: v.detach().contiguous().clone() for k, v in tensors.items()}, scratch, metadata)
        os.replace(scratch, path)
    except (OSError, SafetensorError) as error:
        raise CheckpointError(f"cannot write {path}: {error}") from error
    finally:
        scratch.unlink(missing_ok=True)


def read_checkpoint(path: Path) -> tuple[dict[str, torch.Tensor], TrainingState]:
    """Read a training checkpoint.

    Raises:
        CheckpointError: When it is missing or cannot be read.
    """
    try:
        with safe_open(path, framework="pt") as file:
            state = TrainingState(**json.loads((file.metadata() or {})["state"]))
            return {key: file.get_tensor(key) for key in file.keys()}, state  # noqa: SIM118
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path} is not a checkpoint of this training ({error})") from error


def export(checkpoint: Path, weights: Path) -> TrainingState:
    """Write the averaged weights of a checkpoint as half-precision safetensors, ready to ship."""
    tensors, state = read_checkpoint(checkpoint)
    kept = {
        key.removeprefix("average."): value.half()
        for key, value in tensors.items()
        if key.startswith("average.") and not key.endswith("num_batches_tracked")
    }
    write_safetensors(weights, kept, {"architecture": "compact", "classes": str(state.label_count)})
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


def train(
    task: TrainingTask,
    folder: Path,
    budget: Budget,
    seed: int = 0,
    workers: int = 2,
    progress: Progress | None = None,
) -> Path:
    """Train, or go on training, in a run folder.

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
        log.info("going on after %d images in %s", found.images, folder)
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
        raise CheckpointError(f"a training process failed; the same command goes on from {folder / CHECKPOINT}")
    return folder / CHECKPOINT
