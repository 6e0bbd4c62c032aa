"""Regularized least squares with whitened targets: the box regressor."""

from __future__ import annotations

import torch

from icub_core.errors import CheckpointError, ConfigError, NotFittedError
from icub_core.interfaces.online_head import OnlineHead
from icub_core.renames import renamed
from icub_segmenters.heads.checks import check_samples, check_training_set
from icub_segmenters.heads.clock import clocked
from icub_segmenters.heads.nystrom import cholesky_with_jitter

WHITENING_FLOOR = 1e-3
"""Added to the eigenvalues of the targets' covariance, as R-CNN does: tiny variances are not blown up."""


@renamed(lam="penalty")
class Rls(OnlineHead):
    """Regularized least squares (ridge regression) of all targets with one factorization, in float64.

    Targets are centered and, if wanted, whitened by W (D + 0.001)^(-1/2) W^T; a column of ones is appended to the
    samples and regularized like the others; (X^T X + lambda I) is not scaled by n.

    Source: thesis 11.3.2, which takes it from R-CNN (Girshick et al., 2014); details as in the released code.
    """

    def __init__(self, penalty: float = 1000.0, whiten: bool = True, device: str = "cpu") -> None:
        """Configure; nothing is computed.

        Args:
            penalty: Regularizer lambda, not multiplied by the number of samples: 1000 suits raw features of the
                thesis's detector, 0.01 to 10 features scaled to norm 20.
            whiten: Decorrelate the targets first.
            device: Where to compute.
        """
        if not penalty > 0:
            raise ConfigError(f"penalty is {penalty}; expected a regularizer above 0")
        self.penalty = penalty
        self.whiten = whiten
        self.device = torch.device(device)
        self.weight: torch.Tensor | None = None
        self.bias: torch.Tensor | None = None

    def fit(self, X: torch.Tensor, Y: torch.Tensor, sample_weight: torch.Tensor | None = None) -> None:
        """Train on X (n, d) and real targets Y (n, t)."""
        check_training_set(X, Y, sample_weight, who="rls")
        wide = torch.cat([X.double(), torch.ones(len(X), 1, dtype=torch.float64, device=X.device)], dim=1)
        wide, targets = wide.to(self.device), Y.double().to(self.device)
        weight = torch.ones(len(X), 1, dtype=torch.float64, device=self.device)
        if sample_weight is not None:
            weight = sample_weight.double().to(self.device).unsqueeze(1)
        with torch.no_grad():
            mean = (weight * targets).sum(dim=0) / weight.sum()
            centered = targets - mean
            whitener = self._whitener(centered, weight)
            solution = _ridge(weight.sqrt() * wide, weight.sqrt() * (centered @ whitener), self.penalty)
            solution = solution @ torch.linalg.inv(whitener)  # back to the targets' own coordinates
        # float64 is for the algebra; scoring is float32 as the features are
        self.weight = solution[:-1].to(X.dtype)
        self.bias = (solution[-1] + mean).to(X.dtype)

    @clocked
    def decision_function(self, X: torch.Tensor) -> torch.Tensor:
        """Return predicted targets (n, t) of X (n, d)."""
        if self.weight is None or self.bias is None:
            raise NotFittedError("rls was asked for values before it was fitted")
        check_samples(X, len(self.weight), who="rls")
        return torch.addmm(self.bias, X.to(self.weight), self.weight).to(X.device)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return weight (d, t) and bias (t,)."""
        if self.weight is None or self.bias is None:
            raise NotFittedError("rls has nothing to save before it was fitted")
        return {"weight": self.weight.cpu(), "bias": self.bias.cpu()}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Load weight and bias."""
        if set(state) != {"weight", "bias"}:
            raise CheckpointError(f"rls: the state has {sorted(state)}; expected ['bias', 'weight']")
        weight, bias = state["weight"], state["bias"]
        if weight.ndim != 2 or bias.shape != weight.shape[1:]:
            raise CheckpointError(
                f"rls: weight {tuple(weight.shape)} and bias {tuple(bias.shape)}; expected (d, t) and (t,)"
            )
        self.weight = weight.to(self.device, copy=True)
        self.bias = bias.to(self.device, copy=True)

    def _whitener(self, centered: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        if not self.whiten:
            return torch.eye(centered.shape[1], dtype=centered.dtype, device=centered.device)
        covariance = centered.T @ (weight * centered) / weight.sum()
        values, vectors = torch.linalg.eigh(covariance)
        return vectors @ torch.diag((values.clamp(min=0) + WHITENING_FLOOR).rsqrt()) @ vectors.T


def _ridge(A: torch.Tensor, B: torch.Tensor, penalty: float) -> torch.Tensor:
    """Return argmin |A W - B|^2 + penalty |W|^2 (d, t) by the smaller of the two Gram matrices, A^T A or A A^T."""
    few = len(A) < A.shape[1]
    gram = A @ A.T if few else A.T @ A
    gram.diagonal().add_(penalty)
    L = cholesky_with_jitter(gram, 1e-14)
    return A.T @ torch.cholesky_solve(B, L) if few else torch.cholesky_solve(A.T @ B, L)
