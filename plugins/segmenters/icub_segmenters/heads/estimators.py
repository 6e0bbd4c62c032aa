"""The heads as scikit-learn estimators: numpy in, numpy out, ready for pipelines and grid searches."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassifierMixin, RegressorMixin
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data

from icub_core.renames import renamed
from icub_segmenters.heads.falkon import Falkon


@renamed(lam="penalty", centers="n_centers")
class _FalkonEstimator(BaseEstimator):
    """Parameters and kernel machinery that regressor and classifier share."""

    def __init__(
        self,
        *,
        kernel: str = "gaussian",
        sigma: float | None = None,
        penalty: float = 1e-5,
        n_centers: int = 1000,
        selection: str = "uniform",
        solver: str = "auto",
        random_state: int = 0,
        device: str = "cpu",
    ) -> None:
        """Store the parameters, as scikit-learn demands; see `Falkon`.

        Args:
            kernel: ``"gaussian"``, ``"laplacian"`` or ``"linear"``.
            sigma: Width of the kernel; None: the root of half the number of features times their variance, which is
                scikit-learn's ``gamma="scale"``.
            penalty: Regularizer lambda, multiplied by the number of samples.
            n_centers: Number of Nystrom centers.
            selection: ``"uniform"`` or ``"balanced"``.
            solver: ``"auto"``, ``"direct"`` or ``"conjugate_gradients"``.
            random_state: Decides the centers.
            device: Where to compute.
        """
        self.kernel = kernel
        self.sigma = sigma
        self.penalty = penalty
        self.n_centers = n_centers
        self.selection = selection
        self.solver = solver
        self.random_state = random_state
        self.device = device

    def _fit_head(self, X: NDArray[Any], Y: NDArray[Any], sample_weight: NDArray[Any] | None) -> None:
        if sample_weight is not None:  # a sample without weight is no sample, not even a center
            counted = sample_weight > 0
            X, Y, sample_weight = X[counted], Y[counted], sample_weight[counted]
        width = self.sigma
        if width is None:
            per_sample = None if sample_weight is None else np.repeat(sample_weight[:, None], X.shape[1], axis=1)
            mean = np.average(X, weights=per_sample)
            variance = float(np.average((X - mean) ** 2, weights=per_sample))
            width = float(np.sqrt(0.5 * X.shape[1] * (variance or 1.0)))
        self.sigma_ = width
        self.head_ = Falkon(
            kernel=self.kernel,
            sigma=width,
            penalty=self.penalty,
            n_centers=self.n_centers,
            selection=self.selection,
            solver=self.solver,
            seed=self.random_state,
            device=self.device,
        )
        weight = None if sample_weight is None else torch.as_tensor(sample_weight)
        # few samples are all centers: once each, so that repeating a sample equals doubling its weight
        centers = torch.as_tensor(np.unique(X, axis=0)) if len(X) <= self.n_centers else None
        self.head_.fit(torch.tensor(X), torch.as_tensor(Y), weight, centers)

    def _scores(self, X: ArrayLike) -> NDArray[Any]:
        check_is_fitted(self)
        checked: Any = validate_data(self, X, reset=False, dtype=[np.float64, np.float32])
        # memory that is mapped read-only is copied: torch knows no such tensors
        samples = checked if checked.flags.writeable else checked.copy()
        return self.head_.decision_function(torch.as_tensor(samples)).numpy()


class FalkonRegressor(RegressorMixin, _FalkonEstimator):
    """Kernel ridge regression on Nystrom centers; one or several targets.

    float64 samples are solved in float64, float32 samples in float32 with float64 factorizations.
    """

    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> FalkonRegressor:
        """Train on X (n, d) and y (n,) or (n, t)."""
        checked: Any = validate_data(self, X, y, multi_output=True, y_numeric=True, dtype=[np.float64, np.float32])
        samples, targets = checked[0], np.asarray(checked[1], dtype=checked[0].dtype)
        weight = None if sample_weight is None else _check_sample_weight(sample_weight, samples)
        self.flat_ = targets.ndim == 1
        # the mean needs no kernel to explain it
        self.offset_ = np.average(targets, axis=0, weights=weight)
        centered = targets - self.offset_
        self._fit_head(samples, centered[:, None] if self.flat_ else centered, weight)
        return self

    def predict(self, X: ArrayLike) -> NDArray[Any]:
        """Return predictions (n,) or (n, t)."""
        scores = self._scores(X)
        return (scores[:, 0] if self.flat_ else scores) + self.offset_

    def __sklearn_tags__(self) -> Any:
        """Say what is supported beyond the default."""
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        return tags


class FalkonClassifier(ClassifierMixin, _FalkonEstimator):
    """One-vs-rest kernel ridge classifiers on shared samples and centers, as the on-line detector uses them."""

    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> FalkonClassifier:
        """Train on X (n, d) and class labels y (n,)."""
        checked: Any = validate_data(self, X, y, dtype=[np.float64, np.float32])
        samples, labels = checked
        check_classification_targets(labels)
        self.classes_, numbers = np.unique(labels, return_inverse=True)
        if len(self.classes_) < 2:
            raise ValueError(f"y has {len(self.classes_)} class; expected at least 2 classes")
        weight = None if sample_weight is None else _check_sample_weight(sample_weight, samples)
        targets = -np.ones((len(samples), len(self.classes_)), dtype=samples.dtype)
        targets[np.arange(len(samples)), numbers] = 1
        self._fit_head(samples, targets[:, 1:] if len(self.classes_) == 2 else targets, weight)
        return self

    def decision_function(self, X: ArrayLike) -> NDArray[Any]:
        """Return scores (n, classes), or (n,) of the second class when there are two."""
        scores = self._scores(X)
        return scores[:, 0] if len(self.classes_) == 2 else scores

    def predict(self, X: ArrayLike) -> NDArray[Any]:
        """Return the class of the best score for each sample (n,)."""
        scores = self.decision_function(X)
        return self.classes_[(scores > 0).astype(int) if scores.ndim == 1 else scores.argmax(axis=1)]
