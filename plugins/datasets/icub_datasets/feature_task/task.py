"""The FEATURE-TASK as one object: prepare the frames, draw augmented samples, read validation frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from icub_datasets.feature_task import cache
from icub_datasets.feature_task.augment import augment
from icub_datasets.feature_task.objects import MESH_COUNT, PRODUCT_COUNT
from icub_datasets.feature_task.renderer import LabelledImage


class FeatureTask:
    """Rendered images of 180 invented objects (thesis 5.3 calls such a pre-training set the FEATURE-TASK)."""

    def __init__(
        self, folder: Path | None = None, frames: int = 10000, validation_frames: int = 400, seed: int = 0
    ) -> None:
        """Say where the frames lie and how many there shall be.

        Args:
            folder: Where frames are kept; None: a folder below the user's cache folder.
            frames: Training frames.
            validation_frames: Frames for evaluation.
            seed: Seed of the scenes.
        """
        self.folder = Path(folder) if folder is not None else cache.default_folder()
        self._wanted = {cache.TRAIN: frames, cache.VALIDATION: validation_frames}
        self._seed = seed
        self._loaded: dict[str, cache.FeatureTaskFrames] = {}

    @property
    def label_count(self) -> int:
        """Number of classes; labels go from 1 to this number."""
        return MESH_COUNT + PRODUCT_COUNT

    def prepare(self, progress: cache.Progress | None = None) -> None:
        """Render the frames that are missing; `progress` is called with (ready, wanted)."""
        for split, count in self._wanted.items():
            cache.generate(self.folder, split, count, self._seed, progress=progress)

    def _frames(self, split: str) -> cache.FeatureTaskFrames:
        if split not in self._loaded:
            self._loaded[split] = cache.FeatureTaskFrames(self.folder, split)
        return self._loaded[split]

    def sample(self, rng: np.random.Generator) -> LabelledImage:
        """One augmented training frame with at least one object."""
        frames = self._frames(cache.TRAIN)
        while True:
            first, second = rng.integers(len(frames), size=2)
            sample = augment(rng, frames[int(first)], frames[int(second)])
            if len(sample.labels):
                return sample

    def validation(self) -> cache.FeatureTaskFrames:
        """The validation frames, as rendered."""
        return self._frames(cache.VALIDATION)
