"""FALKON's preconditioned conjugate gradients on the Nystrom normal equations, many right-hand sides at once.

Source: Rudi, Carratino, Rosasco, "FALKON: an optimal large scale kernel method", NIPS 2017, algorithm 1. The
preconditioner is factorized in float64, so that it needs next to no jitter: the solution is that of the normal
equations themselves, not of a system with the library's extra ridge of lambda n eps M.
"""

from __future__ import annotations

import logging

import torch

from icub_segmenters.heads.kernels import Kernel, squares
from icub_segmenters.heads.nystrom import cholesky_with_jitter, row_blocks

log = logging.getLogger(__name__)

STORED_ROWS_BYTES = 2**30
"""Kernel rows up to this size are kept; beyond it they are computed again in every iteration."""
MAX_ITERATIONS = 200
FIRST_JITTER = 1e-12
"""Relative jitter of K_MM in float64."""
BANDWIDTH_FACTOR = 40
"""A product with few columns moves memory instead of computing: it costs as much as one with this many columns."""
USUAL_ITERATIONS = 20


def is_cheaper_than_direct(n: int, M: int, problems: int) -> bool:
    """Compare the arithmetic of about 20 iterations with that of forming and factorizing the Gram matrix.

    Both first compute the kernel rows. Direct then takes 1.25 n M^2 + M^3 / 3, an iteration 4 n M max(problems, 40).
    """
    direct = 1.25 * n * M**2 + M**3 / 3
    iterations = USUAL_ITERATIONS * 4 * n * M * max(problems, BANDWIDTH_FACTOR) + M**3
    return iterations < direct and 4 * n * M <= STORED_ROWS_BYTES


class _Rows:
    """K_nM, kept or computed again block by block, scaled by the roots of the weights."""

    def __init__(
        self, X: torch.Tensor, centers: torch.Tensor, kernel: Kernel, root_weight: torch.Tensor | None
    ) -> None:
        self.X, self.centers, self.kernel, self.root_weight = X, centers, kernel, root_weight
        self.squares = squares(centers)
        self.blocks = list(row_blocks(len(X), len(centers), centers.element_size()))
        fits = len(X) * len(centers) * centers.element_size() <= STORED_ROWS_BYTES
        self.stored = [self._compute(block) for block in self.blocks] if fits else None

    def _compute(self, block: slice) -> torch.Tensor:
        K = self.kernel(self.X[block].to(self.centers), self.centers, self.squares)
        return K if self.root_weight is None else K * self.root_weight[block].to(K).unsqueeze(1)

    def block(self, number: int) -> torch.Tensor:
        return self.stored[number] if self.stored is not None else self._compute(self.blocks[number])

    def normal_product(self, V: torch.Tensor) -> torch.Tensor:
        """Return K^T K V (M, t) float64 of V (M, t) float64."""
        narrow = V.to(self.centers)
        total = torch.zeros_like(V)
        for number in range(len(self.blocks)):
            K = self.block(number)
            total += K.T @ (K @ narrow)
        return total

    def transposed_product(self, Y: torch.Tensor) -> torch.Tensor:
        """Return K^T Y (M, t) float64 of Y (n, t)."""
        total = torch.zeros(len(self.centers), Y.shape[1], dtype=torch.float64, device=Y.device)
        for number, block in enumerate(self.blocks):
            total += self.block(number).T @ Y[block]
        return total


def solve_by_conjugate_gradients(
    X: torch.Tensor,
    Y: torch.Tensor,
    centers: torch.Tensor,
    kernel: Kernel,
    penalty: float,
    sample_weight: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return alpha (M, t) of samples X (n, d), targets Y (n, t) and centers (M, d), in the centers' dtype."""
    M = len(centers)
    root_weight = None if sample_weight is None else sample_weight.sqrt()
    n = float(len(X)) if sample_weight is None else float(sample_weight.sum())
    rows = _Rows(X, centers, kernel, root_weight)
    Y = Y.to(centers)
    if root_weight is not None:
        Y = Y * root_weight.to(Y).unsqueeze(1)

    wide = centers.double()
    T = cholesky_with_jitter(kernel(wide, wide), FIRST_JITTER).T  # upper, T^T T = K_MM
    inner = T @ T.T / M
    inner.diagonal().add_(penalty)
    A = cholesky_with_jitter(inner, FIRST_JITTER).T  # upper, A^T A = T T^T / M + lambda I

    def apply(beta: torch.Tensor) -> torch.Tensor:
        """Return A^-T (T^-T K^T K T^-1 / n + lambda I) A^-1 beta."""
        v = torch.linalg.solve_triangular(A, beta, upper=True)
        w = rows.normal_product(torch.linalg.solve_triangular(T, v, upper=True)) / n
        w = torch.linalg.solve_triangular(T.T, w, upper=False) + penalty * v
        return torch.linalg.solve_triangular(A.T, w, upper=False)

    residual = torch.linalg.solve_triangular(T.T, rows.transposed_product(Y) / n, upper=False)
    residual = torch.linalg.solve_triangular(A.T, residual, upper=False)
    beta = _conjugate_gradients(apply, residual, tolerance=max(10 * torch.finfo(centers.dtype).eps, 1e-13))
    v = torch.linalg.solve_triangular(A, beta, upper=True)
    return torch.linalg.solve_triangular(T, v, upper=True).to(centers)


def _conjugate_gradients(apply, right_side: torch.Tensor, tolerance: float) -> torch.Tensor:  # noqa: ANN001
    """Solve for every column of `right_side` (M, t) at once, each until its residual falls by `tolerance`."""
    solution = torch.zeros_like(right_side)
    residual = right_side.clone()
    direction = residual.clone()
    square = (residual * residual).sum(dim=0)
    goal = square * tolerance**2
    for iteration in range(MAX_ITERATIONS):
        active = square > goal
        if not bool(active.any()):
            log.debug("conjugate gradients converged in %d iterations", iteration)
            return solution
        image = apply(direction)
        curvature = (direction * image).sum(dim=0)
        step = torch.where(active, square / curvature, 0.0)  # a finished column stays as it is
        solution += step * direction
        residual -= step * image
        fresh = (residual * residual).sum(dim=0)
        direction = residual + torch.where(active, fresh / square, 0.0) * direction
        square = torch.where(active, fresh, square)
    log.warning("conjugate gradients stopped after %d iterations; is the penalty too small?", MAX_ITERATIONS)
    return solution
