"""The data set `feature_task`: rendered once, then read like any other, or drawn from with augmentation."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import DataError
from icub_core.geometry import pinhole
from icub_core.interfaces.dataset import Dataset
from icub_datasets.feature_task import cache
from icub_datasets.feature_task.augment import augment
from icub_datasets.feature_task.objects import MESH_COUNT, PRODUCT_COUNT, feature_task_objects
from icub_datasets.feature_task.renderer import LabeledImage

MIDDLE_FOVY = 0.85
"""Stands in for the vertical field of view, which varies from frame to frame (depth is 0: nothing depends on it)."""
DEFAULT_FRAMES = {cache.TRAIN: 10_000, cache.VALIDATION: 400}


class FeatureTask(Dataset):
    """Rendered images of 180 invented objects, for the pre-training of feature extractors (thesis 5.3).

    Nothing is rendered before `prepare` is called. Depth is 0 everywhere: only colors and masks are kept.
    """

    def __init__(
        self, path: Path | None = None, split: str = "train", frames: int | None = None, seed: int = 0
    ) -> None:
        """Say where the frames lie and how many there shall be.

        Args:
            path: Folder of the frames (about 35 kB each); None: a folder below the user's cache folder.
            split: "train" or "validation"; the same classes in other scenes.
            frames: How many, rounded up to hundreds; None: 10,000 for training, 400 for validation.
            seed: Seed of the scenes; the classes are always the same.

        Raises:
            DataError: For another split, or no frames.
        """
        if split not in DEFAULT_FRAMES:
            raise DataError(f"no split '{split}' of the FEATURE-TASK; known: {', '.join(DEFAULT_FRAMES)}")
        wanted = DEFAULT_FRAMES[split] if frames is None else frames
        if wanted < 1:
            raise DataError(f"frames={frames}; expected at least 1")
        self.path = Path(path) if path is not None else cache.default_folder()
        self.split, self._seed = split, seed
        self._length = -(-wanted // cache.SHARD_FRAMES) * cache.SHARD_FRAMES
        self._loaded: cache.FeatureTaskFrames | None = None

    @property
    def label_count(self) -> int:
        """Number of classes; labels of samples go from 1 to this number."""
        return MESH_COUNT + PRODUCT_COUNT

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the classes; the first has label 1."""
        return _class_names()

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits."""
        return tuple(DEFAULT_FRAMES)

    def prepare(self, progress: cache.Progress | None = None) -> None:
        """Render the frames that are missing; `progress` is called with (ready, wanted)."""
        cache.generate(self.path, self.split, self._length, self._seed, progress=progress)

    def _frames(self) -> cache.FeatureTaskFrames:
        if self._loaded is None:
            self._loaded = cache.FeatureTaskFrames(self.path, self.split, self._length // cache.SHARD_FRAMES)
        return self._loaded

    def __len__(self) -> int:
        return self._length

    def labeled(self, index: int) -> LabeledImage:
        """Frame `index` as it was rendered."""
        if not 0 <= index < self._length:
            raise IndexError(f"frame {index} of {self._length}")
        return self._frames()[index]

    def __getitem__(self, index: int) -> tuple[RgbdFrame, tuple[Instance, ...]]:
        """Frame `index` and its visible objects."""
        image = self.labeled(index)
        height, width = image.instances.shape
        depth = np.zeros((height, width), dtype=np.float32)
        frame = RgbdFrame(image.rgb, depth, pinhole(width, height, MIDDLE_FOVY), np.eye(4))
        names = self.classes
        return frame, tuple(
            Instance.from_mask(names[label - 1], image.instances == i) for i, label in enumerate(image.labels, start=1)
        )

    def sample(self, rng: np.random.Generator) -> LabeledImage:
        """Draw one augmented frame with at least one object."""
        frames = self._frames()
        while True:
            first, second = rng.integers(len(frames), size=2)
            sample = augment(rng, frames[int(first)], frames[int(second)])
            if len(sample.labels):
                return sample


@functools.cache
def _class_names() -> tuple[str, ...]:
    return tuple(item.name for item in feature_task_objects())
