"""The normal equations of Nystrom kernel ridge regression, summed up block by block and solved directly.

(K_nM^T W K_nM + lambda n K_MM) alpha = K_nM^T W Y, with n the sum of the weights: FALKON's convention, in which lambda
multiplies the number of samples. The left side does not know the targets: any number of problems share it.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch

from icub_core.errors import DataError
from icub_segmenters.heads.kernels import Kernel, squares
from icub_segmenters.heads.products import fast_products

BLOCK_BYTES = 32 * 2**20
"""Size of one block of kernel rows; larger blocks leave the caches without being faster."""
PANELS = 8
"""Column panels of a Gram matrix; only the lower block triangle is computed (36 of 64 products)."""
FIRST_JITTER = {torch.float32: 1e-9, torch.float64: 1e-14}
"""Relative to the mean diagonal; grown only where the factorization fails."""
MAX_JITTER = 1e-2
"""Relative to the mean diagonal; a matrix that needs more is no kernel matrix."""


def row_blocks(n: int, width: int, itemsize: int) -> Iterator[slice]:
    """Cut n rows of `width` numbers into slices of at most BLOCK_BYTES."""
    rows = max(256, BLOCK_BYTES // (width * itemsize))
    for start in range(0, n, rows):
        yield slice(start, min(start + rows, n))


def add_gram(total: torch.Tensor, K: torch.Tensor) -> None:
    """Add K^T K to the lower triangle of `total` (m, m) float64, for K (n, m); the rest of it stays undefined."""
    m = K.shape[1]
    edges = [round(i * m / PANELS) for i in range(PANELS + 1)]
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        total[start:stop, :stop] += K[:, start:stop].T @ K[:, :stop]


def cholesky_with_jitter(A: torch.Tensor, first: float) -> torch.Tensor:
    """Factorize A (m, m) float64, adding `first` x mean diagonal to the diagonal, ten times more on each failure.

    Only the lower triangle of A is looked at; its diagonal is left with the jitter added.

    Returns:
        Lower triangular L with L L^T = A + jitter I.

    Raises:
        DataError: When even MAX_JITTER does not help.
    """
    scale = float(A.diagonal().mean())
    relative, added = first, 0.0
    while relative <= MAX_JITTER:
        A.diagonal().add_((relative - added) * scale)
        L, info = torch.linalg.cholesky_ex(A)
        if int(info) == 0:
            return L
        added = relative
        relative *= 10
    raise DataError("the kernel matrix cannot be factorized; are the features constant or the kernel width absurd?")


class NystromSystem:
    """Sums K^T W K and K^T W Y over samples that come in any order and number.

    The products are float32 where the samples are; their rounding, relative to the entries, would drown the small
    eigenvalues that decide the solution. So each column of K first loses a constant near its mean, and what that
    changes is put back in float64: the entries shrink to their variation and the error of the solution falls by a
    factor of 50 on realistic features, at the price of one subtraction.
    """

    def __init__(self, centers: torch.Tensor, kernel: Kernel, problems: int, penalty: float) -> None:
        """Start with no samples.

        Args:
            centers: (M, d) float32 or float64; decides the precision of the kernel rows.
            kernel: Evaluated between samples and centers.
            problems: Number of targets (t).
            penalty: Regularizer lambda.
        """
        self.kernel, self.penalty = kernel, penalty
        self._set_centers(centers)
        M = len(centers)
        self.offset: torch.Tensor | None = None  # (M,), subtracted from the columns of K
        # these sums are of the shifted columns; only the lower triangle of `gram` is valid
        self.gram = torch.zeros(M, M, dtype=torch.float64, device=centers.device)
        self.right_side = self.gram.new_zeros(M, problems)
        self.row_sum = self.gram.new_zeros(M)
        self.target_sum = self.gram.new_zeros(problems)
        self.weight = 0.0
        self._solution: torch.Tensor | None = None  # of the samples so far

    @property
    def problems(self) -> int:
        """Number of targets."""
        return self.right_side.shape[1]

    def rows(self, X: torch.Tensor, out: torch.Tensor | None = None) -> torch.Tensor:
        """Return kernel rows K(X, centers) (n, M), written to `out` if it is given."""
        with fast_products(self.centers.device):
            return self.kernel(X.to(self.centers), self.centers, self.center_squares, out)

    def scores(self, K: torch.Tensor) -> torch.Tensor:
        """Return the scores (n, t) of samples with kernel rows K (n, M), from all samples added so far."""
        with fast_products(self.centers.device):
            return K @ self.solve()

    def add(self, X: torch.Tensor, Y: torch.Tensor, sample_weight: torch.Tensor | None = None) -> None:
        """Add samples X (n, d) with targets Y (n, t), in blocks."""
        buffer = None
        for block in row_blocks(len(X), len(self.centers), self.centers.element_size()):
            count = block.stop - block.start
            if buffer is None:  # the first block is the largest
                buffer = self.centers.new_empty(count, len(self.centers))
            weight = None if sample_weight is None else sample_weight[block]
            self.add_rows(self.rows(X[block], buffer[:count]), Y[block], weight)

    def add_rows(self, K: torch.Tensor, Y: torch.Tensor, sample_weight: torch.Tensor | None = None) -> None:
        """Add samples whose kernel rows K (n, M) are known; K is overwritten."""
        if len(K) == 0:
            return
        self._solution = None
        with fast_products(self.centers.device):
            if self.offset is None:
                self.offset = K.mean(dim=0)
            shifted, Y = K.sub_(self.offset), Y.to(K)
            if sample_weight is None:
                self.row_sum += shifted.sum(dim=0)
                self.target_sum += Y.sum(dim=0)
                self.weight += float(len(K))
            else:
                root = sample_weight.to(K).sqrt().unsqueeze(1)
                shifted *= root
                Y = Y * root
                self.row_sum += (shifted * root).sum(dim=0)
                self.target_sum += (Y * root).sum(dim=0)
                self.weight += float(sample_weight.sum())
            add_gram(self.gram, shifted)
            self.right_side += shifted.T @ Y

    def add_problems(self, count: int) -> None:
        """Append `count` problems of which every sample so far is a negative (target -1)."""
        self._solution = None
        self.right_side = torch.cat([self.right_side, -self.row_sum.unsqueeze(1).expand(-1, count)], dim=1)
        self.target_sum = torch.cat([self.target_sum, self.target_sum.new_full((count,), -self.weight)])

    def extend_centers(self, centers: torch.Tensor, X: torch.Tensor, Y: torch.Tensor) -> None:
        """Append centers (m, d); X (n, d) and Y (n, t) are all samples so far, unweighted.

        Only the new columns of the Gram matrix are computed: n m (M + m) products instead of n (M + m)^2.
        """
        self._solution = None
        M, m = len(self.centers), len(centers)
        old_centers, old_squares, old_offset = self.centers, self.center_squares, self.offset
        old_gram, old_right_side, old_row_sum = self.gram, self.right_side, self.row_sum
        self._set_centers(torch.cat([old_centers, centers.to(old_centers)]))
        self.gram = torch.zeros(M + m, M + m, dtype=torch.float64, device=old_gram.device)
        self.gram[:M, :M] = old_gram
        fresh, fresh_sum = old_right_side.new_zeros(m, self.problems), old_row_sum.new_zeros(m)
        fresh_offset: torch.Tensor | None = None
        for block in row_blocks(len(X), M + m, old_centers.element_size()):
            x = X[block].to(old_centers)
            K_new = self.kernel(x, self.centers[M:], self.center_squares[M:])
            if fresh_offset is None:
                fresh_offset = K_new.mean(dim=0)
            K_new -= fresh_offset
            K_old = self.kernel(x, old_centers, old_squares)
            if old_offset is not None:
                K_old -= old_offset
            self.gram[M:, :M] += K_new.T @ K_old
            self.gram[M:, M:] += K_new.T @ K_new
            fresh += K_new.T @ Y[block].to(K_new)
            fresh_sum += K_new.sum(dim=0)
        self.right_side = torch.cat([old_right_side, fresh])
        self.row_sum = torch.cat([old_row_sum, fresh_sum])
        if old_offset is not None and fresh_offset is not None:
            self.offset = torch.cat([old_offset, fresh_offset])

    def solve(self) -> torch.Tensor:
        """Return alpha (M, t) in the centers' dtype: one Cholesky factorization in float64 for all problems."""
        if self._solution is None:
            with torch.no_grad():
                self._solution = self._solved()
        return self._solution

    def _solved(self) -> torch.Tensor:
        H = torch.add(self.gram, self.K_MM, alpha=self.penalty * self.weight)
        B = self.right_side
        if self.offset is not None:  # undo the shift: K = shifted + 1 offset^T
            offset = self.offset.double()
            moved = self.row_sum + 0.5 * self.weight * offset
            H.addr_(moved, offset).addr_(offset, moved)
            B = B + torch.outer(offset, self.target_sum)
        L = cholesky_with_jitter(H, FIRST_JITTER[self.centers.dtype])
        return torch.cholesky_solve(B, L).to(self.centers)

    def _set_centers(self, centers: torch.Tensor) -> None:
        self.centers = centers
        self.center_squares = squares(centers)
        wide = centers.double()
        self.K_MM = self.kernel(wide, wide)
