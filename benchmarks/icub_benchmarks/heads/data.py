"""Synthetic region features for `icub benchmark heads`, sizes, and the precision of what was learned from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.metrics import average_precision_score

from icub_segmenters.region_store import BACKGROUND

SIGMA, LAM = 15.0, 1e-5
"""Width and regularizer of the thesis's detector on features of norm 20."""
LATENT, VIEWS, BACKGROUNDS = 32, 6, 120
"""Dimensions of the latent space, views of a class, kinds of background."""
NOISE = 1.2
"""Spread of samples around their view: at this the best mean average precision is about 85 points."""
MAX_BACKGROUND_TESTED = 20_000


@dataclass(frozen=True)
class Sizes:
    """What is measured at.

    Attributes:
        classes, dim, centers: t, d, M.
        batches, batch_size: n_B and BS.
        positives: Of each class.
        tests: Test samples of each class; background is ten times as much in all, and bounded.
        samples: n of the shared solve.
        per_image: Negatives an image has in the store.
    """

    classes: int = 21
    dim: int = 1024
    centers: int = 1000
    batches: int = 10
    batch_size: int = 2000
    positives: int = 300
    tests: int = 100
    samples: int = 20_000
    per_image: int = 30


QUICK = Sizes(3, 64, 100, 3, 200, 40, 30, 1500, 10)


class Mixture:
    """Draws features (n, d) float32 of mean norm about 20."""

    def __init__(self, sizes: Sizes, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)
        kinds = sizes.classes * VIEWS + BACKGROUNDS
        self.sizes = sizes
        self.views = self._normal(kinds, LATENT)
        # classes of one family are look-alikes
        family = self._normal(-(-sizes.classes // 3), 1, LATENT).repeat_interleave(3, dim=0)[: sizes.classes]
        self.views[: sizes.classes * VIEWS] = (family + 0.9 * self._normal(sizes.classes, VIEWS, LATENT)).flatten(0, 1)
        self.lens = self._normal(LATENT, sizes.dim) / math.sqrt(LATENT)
        self.scale = 1.0
        self.mean = torch.zeros(sizes.dim)
        sample = self.background(2000)
        self.mean = sample.mean(dim=0)
        self.scale = 20.0 / float((sample - self.mean).norm(dim=1).mean())

    def of_class(self, number: int, count: int) -> torch.Tensor:
        """Draw `count` samples of a class."""
        return self._seen(number * VIEWS + self._whole(VIEWS, count))

    def background(self, count: int) -> torch.Tensor:
        """Draw `count` samples of background."""
        return self._seen(self.sizes.classes * VIEWS + self._whole(BACKGROUNDS, count))

    def labeled(self, positives: int, background: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return samples and class numbers, -1 for background, in random order."""
        parts = [self.of_class(c, positives) for c in range(self.sizes.classes)] + [self.background(background)]
        label = torch.cat([torch.full((len(p),), c) for c, p in enumerate(parts)])
        label[label == self.sizes.classes] = BACKGROUND
        order = torch.randperm(len(label), generator=self.generator)
        return torch.cat(parts)[order], label[order]

    def tests(self) -> tuple[torch.Tensor, NDArray[np.int64]]:
        """Return test samples and their class numbers."""
        sizes = self.sizes
        background = min(10 * sizes.tests * sizes.classes, MAX_BACKGROUND_TESTED)
        X, label = self.labeled(sizes.tests, background)
        return X, label.numpy()

    def _seen(self, kind: torch.Tensor) -> torch.Tensor:
        latent = self.views[kind] + NOISE * self._normal(len(kind), LATENT)
        return (torch.relu(latent @ self.lens) - self.mean) * self.scale

    def _normal(self, *shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=self.generator)

    def _whole(self, below: int, count: int) -> torch.Tensor:
        return torch.randint(below, (count,), generator=self.generator)


def mean_precision(scores: NDArray[np.float32], label: NDArray[np.int64]) -> float:
    """Return the mean average precision, in points, of scores (n, t) for class numbers (n,)."""
    return 100 * float(np.mean([average_precision_score(label == c, scores[:, c]) for c in range(scores.shape[1])]))
