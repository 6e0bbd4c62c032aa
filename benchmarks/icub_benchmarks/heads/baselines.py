"""Baselines of the benchmark `heads`: scikit-learn's Nystroem and Ridge, and the FALKON library if it is installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.kernel_approximation import Nystroem
from sklearn.linear_model import Ridge

from icub_benchmarks.heads.data import LAM, SIGMA
from icub_segmenters.minibootstrap import Minibootstrap


class NystroemRidge:
    """scikit-learn's way to the same function: features of the centers' kernel, then ridge regression."""

    def __init__(self, centers: int, seed: int) -> None:
        self.centers, self.seed = centers, seed

    def fit(self, X: NDArray[np.float32], Y: NDArray[np.float32]) -> NystroemRidge:
        """Train on X (n, d) and Y (n, t)."""
        self.map = Nystroem(gamma=0.5 / SIGMA**2, n_components=min(self.centers, len(X)), random_state=self.seed)
        self.ridge = Ridge(alpha=LAM * len(X), fit_intercept=False)
        self.ridge.fit(self.map.fit_transform(X), Y)
        return self

    def score(self, X: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return scores (n, t)."""
        return self.ridge.predict(self.map.transform(X))


def sklearn_minibootstrap(
    procedure: Minibootstrap,
    centers: int,
    X: NDArray[np.float32],
    positives: NDArray[np.int64],
    negatives: NDArray[np.int64],
) -> NystroemRidge:
    """Train one class by Algorithm 1, as `Minibootstrap.train_class`."""

    def fitted(chosen: NDArray[np.int64]) -> NystroemRidge:
        Y = np.concatenate([np.ones(len(positives)), -np.ones(len(chosen))]).astype(np.float32)
        return NystroemRidge(centers, 0).fit(X[np.concatenate([positives, chosen])], Y)

    chosen, *rest = (negatives[i : i + procedure.batch_size] for i in range(0, len(negatives), procedure.batch_size))
    head = fitted(chosen)
    for batch in rest:
        chosen = chosen[head.score(X[chosen]) >= procedure.easy]
        chosen = np.concatenate([chosen, batch[head.score(X[batch]) > procedure.hard]])
        head = fitted(chosen)
    return head


def falkon_library(centers: int) -> Callable[[torch.Tensor, torch.Tensor], object] | None:
    """Return a fit by the FALKON library, with the options that suit it best on a CPU, or None where it is absent."""
    if importlib.util.find_spec("falkon") is None:
        return None
    import falkon

    options = falkon.FalkonOptions(
        use_cpu=True, keops_active="no", store_kernel_d_threshold=0, no_single_kernel=False, cg_epsilon_32=1e-15
    )

    def fit(X: torch.Tensor, Y: torch.Tensor) -> object:
        kernel = falkon.kernels.GaussianKernel(SIGMA)
        return falkon.Falkon(kernel=kernel, penalty=LAM, M=centers, options=options).fit(X, Y)

    return fit
