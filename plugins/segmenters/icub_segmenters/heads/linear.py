"""Linear classifiers trained by gradient descent on stored features: the baseline of the kernel heads."""

from __future__ import annotations

import torch
from torch.nn import functional

from icub_core.errors import CheckpointError, ConfigError, NotFittedError, unknown_name
from icub_core.interfaces.online_head import OnlineHead, Score
from icub_segmenters.heads.checks import check_samples, check_training_set
from icub_segmenters.heads.clock import clocked
from icub_segmenters.heads.products import fast_products

LOSSES = ("softmax", "logistic")
OPTIMIZERS = ("adam", "lbfgs")


class Linear(OnlineHead):
    """Linear classifiers: softmax over all classes and background, or one logistic regression per class.

    With ``"softmax"`` a sample belongs to its first positive column, or to background where it has none; the score of
    a column is its logit minus the background's.

    Source: the output layer of Mask R-CNN, fine-tuned alone on frozen features (thesis 10.4, "output layers").
    """

    def __init__(
        self,
        loss: str = "softmax",
        optimizer: str = "adam",
        epochs: int = 20,
        learning_rate: float = 1e-3,
        batch_size: int = 256,
        weight_decay: float = 1e-4,
        seed: int = 0,
        device: str = "cpu",
    ) -> None:
        """Configure; nothing is computed.

        Args:
            loss: ``"softmax"`` or ``"logistic"``.
            optimizer: ``"adam"`` on random batches, or ``"lbfgs"`` on all samples at once.
            epochs: Passes over the samples; for L-BFGS the highest number of iterations.
            learning_rate: Of Adam, cosine to zero; L-BFGS searches along lines instead.
            batch_size: Samples an Adam step sees.
            weight_decay: Penalty 0.5 x weight_decay x |W|^2; the bias is free.
            seed: Decides the order of the samples.
            device: Where to compute.
        """
        if loss not in LOSSES:
            raise ConfigError(unknown_name("loss", loss, LOSSES))
        if optimizer not in OPTIMIZERS:
            raise ConfigError(unknown_name("optimizer", optimizer, OPTIMIZERS))
        if epochs < 1 or batch_size < 1:
            raise ConfigError(f"epochs is {epochs} and batch_size {batch_size}; expected at least 1")
        self.loss, self.optimizer, self.epochs = loss, optimizer, epochs
        self.learning_rate, self.batch_size, self.weight_decay = learning_rate, batch_size, weight_decay
        self.seed = seed
        self.device = torch.device(device)
        self.weight: torch.Tensor | None = None
        self.bias: torch.Tensor | None = None

    @property
    def score(self) -> Score:
        """Scores are log odds."""
        return "log_odds"

    def fit(self, X: torch.Tensor, Y: torch.Tensor, sample_weight: torch.Tensor | None = None) -> None:
        """Train on X (n, d) and Y (n, t) from zero weights."""
        check_training_set(X, Y, sample_weight, who="linear")
        X = X.to(self.device)
        positive = (Y > 0).to(self.device)
        sample = torch.ones(len(X)) if sample_weight is None else sample_weight / sample_weight.mean()
        sample = sample.to(self.device, X.dtype)
        if self.loss == "softmax":
            # column 0 is background
            targets = torch.where(positive.any(dim=1), positive.int().argmax(dim=1) + 1, 0)
            outputs = Y.shape[1] + 1
        else:
            targets = positive.to(X.dtype)
            outputs = Y.shape[1]
        W = torch.zeros(outputs, X.shape[1], dtype=X.dtype, device=self.device, requires_grad=True)
        b = torch.zeros(outputs, dtype=X.dtype, device=self.device, requires_grad=True)

        def risk(rows: torch.Tensor | slice) -> torch.Tensor:
            logits = functional.linear(X[rows], W, b)
            if self.loss == "softmax":
                each = functional.cross_entropy(logits, targets[rows], reduction="none")
            else:
                each = functional.binary_cross_entropy_with_logits(logits, targets[rows], reduction="none").sum(dim=1)
            return (sample[rows] * each).mean() + 0.5 * self.weight_decay * (W * W).sum()

        # gradients are wanted although the caller may have switched them off
        with fast_products(self.device), torch.enable_grad():
            if self.optimizer == "adam":
                self._adam([W, b], risk, len(X))
            else:
                self._lbfgs([W, b], risk)
        W, b = W.detach(), b.detach()
        if self.loss == "softmax":
            W, b = W[1:] - W[:1], b[1:] - b[:1]
        self.weight, self.bias = W.T.contiguous(), b

    def _adam(self, parameters: list[torch.Tensor], risk, n: int) -> None:  # noqa: ANN001
        optimizer = torch.optim.Adam(parameters, lr=self.learning_rate)
        steps = self.epochs * -(-n // self.batch_size)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        generator = torch.Generator().manual_seed(self.seed)
        for _ in range(self.epochs):
            for rows in torch.randperm(n, generator=generator).split(self.batch_size):
                optimizer.zero_grad()
                risk(rows.to(self.device)).backward()
                optimizer.step()
                schedule.step()

    def _lbfgs(self, parameters: list[torch.Tensor], risk) -> None:  # noqa: ANN001
        optimizer = torch.optim.LBFGS(parameters, max_iter=self.epochs, line_search_fn="strong_wolfe")

        def closure() -> torch.Tensor:
            optimizer.zero_grad()
            value = risk(slice(None))
            value.backward()
            return value

        optimizer.step(closure)

    @clocked
    def decision_function(self, X: torch.Tensor) -> torch.Tensor:
        """Return scores (n, t) of X (n, d): log odds against background, or against "not this class"."""
        if self.weight is None or self.bias is None:
            raise NotFittedError("linear was asked for scores before it was fitted")
        check_samples(X, len(self.weight), who="linear")
        with fast_products(self.device):
            return torch.addmm(self.bias, X.to(self.weight), self.weight).to(X.device)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return weight (d, t) and bias (t,)."""
        if self.weight is None or self.bias is None:
            raise NotFittedError("linear has nothing to save before it was fitted")
        return {"weight": self.weight.cpu(), "bias": self.bias.cpu()}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Load weight and bias."""
        if set(state) != {"weight", "bias"}:
            raise CheckpointError(f"linear: the state has {sorted(state)}; expected ['bias', 'weight']")
        weight, bias = state["weight"], state["bias"]
        if weight.ndim != 2 or bias.shape != weight.shape[1:]:
            raise CheckpointError(
                f"linear: weight {tuple(weight.shape)} and bias {tuple(bias.shape)}; expected (d, t) and (t,)"
            )
        self.weight, self.bias = weight.to(self.device, copy=True), bias.to(self.device, copy=True)
