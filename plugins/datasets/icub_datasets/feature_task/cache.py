"""A compact folder of rendered FEATURE-TASK frames, written once, resumable, and read back into memory.

Frames lie in shards (``shard_0000.npz``): images as JPEG, instance maps as PNG, class labels as integers. A shard
appears under its name only when it is complete, so that an interrupted generation resumes where it stopped.
"""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import time
from collections.abc import Callable
from pathlib import Path
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.typing import NDArray

from icub_core.errors import DataError
from icub_core.files import cache_dir
from icub_datasets.feature_task.objects import mesh_folder
from icub_datasets.feature_task.renderer import FeatureTaskRenderer, LabeledImage

log = logging.getLogger(__name__)

SHARD_FRAMES = 100
TRAIN, VALIDATION = "train", "validation"
_SPLITS = {TRAIN: 10, VALIDATION: 11}  # first word of a frame's seed: the splits never share a scene
_JPEG_QUALITY = 95

Progress = Callable[[int, int], None]


def default_folder() -> Path:
    """Where frames go unless the user names a folder."""
    return cache_dir() / "feature_task"


def _shard_path(folder: Path, split: str, index: int) -> Path:
    return folder / f"{split}_{index:04d}.npz"


def _join(blobs: list[NDArray[np.uint8]]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    return np.concatenate(blobs), np.cumsum([0] + [len(b) for b in blobs]).astype(np.int64)


def _write_shard(path: Path, frames: list[LabeledImage]) -> None:
    images = [cv2.imencode(".jpg", f.rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1] for f in frames]
    maps = [cv2.imencode(".png", f.instances)[1] for f in frames]
    jpeg, jpeg_at = _join([b.ravel() for b in images])
    png, png_at = _join([b.ravel() for b in maps])
    labels, labels_at = _join([f.labels.astype(np.uint8) for f in frames])
    scratch = path.with_suffix(f".{os.getpid()}.tmp")
    try:
        with scratch.open("wb") as file:
            np.savez(file, jpeg=jpeg, jpeg_at=jpeg_at, png=png, png_at=png_at, labels=labels, labels_at=labels_at)
        os.replace(scratch, path)
    finally:
        scratch.unlink(missing_ok=True)


def _render_shards(folder: Path, split: str, seed: int, shards: list[int]) -> None:
    cv2.setNumThreads(1)
    with FeatureTaskRenderer() as renderer:
        for shard in shards:
            first = shard * SHARD_FRAMES
            frames = [renderer.render([_SPLITS[split], seed, i]) for i in range(first, first + SHARD_FRAMES)]
            _write_shard(_shard_path(folder, split, shard), frames)


def _check_recipe(folder: Path, seed: int) -> None:
    """Refuse to mix frames of two seeds in one folder."""
    card = folder / "recipe.json"
    recipe = {"seed": seed, "version": 2}
    if card.exists():
        found = json.loads(card.read_text())
        if found != recipe:
            raise DataError(f"{folder} holds frames of recipe {found}, expected {recipe}; name another folder")
        return
    card.write_text(json.dumps(recipe))


def generate(
    folder: Path,
    split: str = TRAIN,
    frames: int = 8000,
    seed: int = 0,
    workers: int = 2,
    progress: Progress | None = None,
) -> None:
    """Render the frames that a folder lacks.

    Args:
        folder: Where the shards go; about 35 kB a frame.
        split: "train" or "validation"; both have the same classes but never the same scenes.
        frames: At least this many frames (rounded up to whole shards of 100).
        seed: Seed of the scenes.
        workers: Processes that render.
        progress: Called with (frames ready, frames wanted) about once a second.

    Raises:
        DataError: Unknown split, a folder of another seed, or missing meshes.
        SimulationError: When MuJoCo cannot render here.
    """
    if split not in _SPLITS:
        raise DataError(f"no split '{split}'; known: {', '.join(_SPLITS)}")
    folder.mkdir(parents=True, exist_ok=True)
    _check_recipe(folder, seed)
    wanted = -(-frames // SHARD_FRAMES)
    missing = [i for i in range(wanted) if not _shard_path(folder, split, i).exists()]
    if not missing:
        return
    mesh_folder()  # refused here, not in every worker
    log.info("rendering %d frames of the FEATURE-TASK into %s", len(missing) * SHARD_FRAMES, folder)
    workers = max(1, min(workers, len(missing)))
    context = multiprocessing.get_context("spawn")
    jobs = [
        context.Process(target=_render_shards, args=(folder, split, seed, missing[i::workers]), daemon=True)
        for i in range(workers)
    ]
    for job in jobs:
        job.start()
    try:
        while any(job.is_alive() for job in jobs):
            if progress is not None:
                ready = sum(_shard_path(folder, split, i).exists() for i in range(wanted))
                progress(ready * SHARD_FRAMES, wanted * SHARD_FRAMES)
            time.sleep(1.0)
    finally:
        for job in jobs:
            if job.is_alive():
                job.terminate()
            job.join()
    if any(job.exitcode for job in jobs):
        raise DataError(
            f"rendering into {folder} failed (exit codes {[job.exitcode for job in jobs]}); see the log above"
        )
    if progress is not None:
        progress(wanted * SHARD_FRAMES, wanted * SHARD_FRAMES)


class FeatureTaskFrames:
    """The frames of a folder, held in memory as compressed bytes."""

    def __init__(self, folder: Path, split: str, shards: int) -> None:
        """Load the first shards of a split.

        Raises:
            DataError: When one is missing or cannot be read.
        """
        paths = [_shard_path(folder, split, i) for i in range(shards)]
        missing = [path.name for path in paths if not path.exists()]
        if missing:
            raise DataError(
                f"{folder} lacks {len(missing)} of {shards} shards of the FEATURE-TASK's {split} frames "
                f"(such as {missing[0]}); render them with FeatureTask.prepare()"
            )
        self._records: list[tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int64]]] = []
        for path in paths:
            try:
                with np.load(path, allow_pickle=False) as shard:
                    data = {key: shard[key] for key in shard.files}
            except (OSError, ValueError, EOFError, BadZipFile) as error:
                raise DataError(f"{path} is not a readable shard ({error}); delete it and render again") from error
            for i in range(len(data["jpeg_at"]) - 1):
                jpeg = data["jpeg"][data["jpeg_at"][i] : data["jpeg_at"][i + 1]]
                png = data["png"][data["png_at"][i] : data["png_at"][i + 1]]
                labels = data["labels"][data["labels_at"][i] : data["labels_at"][i + 1]].astype(np.int64)
                self._records.append((jpeg, png, labels))

    def __len__(self) -> int:
        return len(self._records)

    def __getitem__(self, index: int) -> LabeledImage:
        """Decode one frame."""
        jpeg, png, labels = self._records[index]
        rgb = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
        instances = cv2.imdecode(png, cv2.IMREAD_GRAYSCALE)
        if rgb is None or instances is None:
            raise DataError(f"frame {index} of the FEATURE-TASK cannot be decoded; delete its shard and render again")
        return LabeledImage(np.ascontiguousarray(rgb[..., ::-1], np.uint8), np.asarray(instances, np.uint8), labels)
