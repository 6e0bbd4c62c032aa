"""FALKON: kernel ridge regression on Nystrom centers, in pure torch."""

from __future__ import annotations

import copy
from typing import Self

import torch

from icub_core.errors import CheckpointError, ConfigError, DataError, NotFittedError, unknown_name
from icub_core.interfaces.abilities import KernelSystem
from icub_core.interfaces.online_head import OnlineHead
from icub_core.renames import renamed
from icub_segmenters.heads.centers import balanced_centers, check_selection, uniform_centers
from icub_segmenters.heads.checks import check_samples, check_training_set
from icub_segmenters.heads.clock import clocked
from icub_segmenters.heads.conjugate_gradients import is_cheaper_than_direct, solve_by_conjugate_gradients
from icub_segmenters.heads.kernels import make_kernel, squares
from icub_segmenters.heads.nystrom import NystromSystem, row_blocks
from icub_segmenters.heads.products import fast_products

SOLVERS = ("auto", "direct", "conjugate_gradients")


@renamed(lam="penalty", centers="n_centers")
class Falkon(OnlineHead):
    """FALKON: kernel ridge regression on Nystrom centers, all classes in one solve.

    f(x) = sum_m alpha_m k(x, c_m) minimizes 1/n sum_i (f(x_i) - y_i)^2 + lambda |f|^2 over the span of the centers c_m.

    All problems (columns of Y) share samples, centers, kernel rows and the factorization. Samples in float32 give
    float32 kernel rows with the M x M algebra in float64; samples in float64 stay float64 throughout.

    Source: thesis 5.2 (eq. 5.2 to 5.4); Rudi, Carratino, Rosasco, NIPS 2017. The regularizer is lambda n K_MM, as in
    the FALKON library.
    """

    def __init__(
        self,
        kernel: str = "gaussian",
        sigma: float = 15.0,
        penalty: float = 1e-5,
        n_centers: int = 1000,
        selection: str = "uniform",
        solver: str = "auto",
        seed: int = 0,
        device: str = "cpu",
    ) -> None:
        """Configure; nothing is computed.

        Args:
            kernel: ``"gaussian"``, ``"laplacian"`` or ``"linear"``.
            sigma: Width of the kernel.
            penalty: Regularizer lambda; it is multiplied by the number of samples.
            n_centers: Number M of Nystrom centers; all samples where there are fewer.
            selection: ``"uniform"``, or ``"balanced"``: evenly over the classes and background (thesis 5.3).
            solver: ``"direct"`` (Cholesky), ``"conjugate_gradients"``, or ``"auto"``: what costs less.
            seed: Decides the centers.
            device: Where to compute, such as ``"cpu"`` or ``"cuda"``.
        """
        if not penalty > 0:
            raise ConfigError(f"penalty is {penalty}; expected a regularizer above 0")
        if n_centers < 1:
            raise ConfigError(f"n_centers is {n_centers}; expected at least 1")
        if solver not in SOLVERS:
            raise ConfigError(unknown_name("solver", solver, SOLVERS))
        check_selection(selection)
        self.kernel = make_kernel(kernel, sigma)
        self.penalty = penalty
        self.n_centers = n_centers
        self.selection = selection
        self.solver = solver
        self.seed = seed
        self.device = torch.device(device)
        self.centers: torch.Tensor | None = None
        self.alpha: torch.Tensor | None = None
        self._center_squares: torch.Tensor | None = None
        self._system: NystromSystem | None = None

    def fit(
        self,
        X: torch.Tensor,
        Y: torch.Tensor,
        sample_weight: torch.Tensor | None = None,
        centers: torch.Tensor | None = None,
    ) -> None:
        """Train on X (n, d) and Y (n, t) alone; an earlier fit has no influence.

        Args:
            X: Samples.
            Y: Targets, usually +1 and -1.
            sample_weight: (n,); weight 2 counts as the same sample twice, also in lambda n.
            centers: (M, d) centers to use instead of drawing them from X.
        """
        check_training_set(X, Y, sample_weight, who="falkon")
        if centers is None:
            centers = X[self.choose_centers(Y)]
        else:
            check_samples(centers, X.shape[1], who="falkon centers")
        precision = torch.float64 if X.dtype == torch.float64 else torch.float32  # half is too coarse to compute in
        centers = centers.to(self.device, precision, copy=True)
        with fast_products(self.device):
            if self._use_conjugate_gradients(len(X), len(centers), Y.shape[1]):
                X, Y = X.to(self.device), Y.to(self.device)
                weight = None if sample_weight is None else sample_weight.to(self.device)
                alpha = solve_by_conjugate_gradients(X, Y, centers, self.kernel, self.penalty, weight)
                self._set(centers, alpha, None)
                return
            system = NystromSystem(centers, self.kernel, Y.shape[1], self.penalty)
            system.add(X, Y.to(self.device), None if sample_weight is None else sample_weight.to(self.device))
            self.adopt(system)

    def choose_centers(self, Y: torch.Tensor) -> torch.Tensor:
        """Draw the indices of the centers among samples with targets Y (n, t)."""
        generator = torch.Generator().manual_seed(self.seed)
        if self.selection == "balanced":
            return balanced_centers(Y.cpu(), self.n_centers, generator)
        return uniform_centers(len(Y), self.n_centers, generator)

    def kernel_system(self, centers: torch.Tensor, problems: int) -> NystromSystem:
        """Return the normal equations without samples, for centers (M, d) and `problems` targets."""
        return NystromSystem(centers.to(self.device), self.kernel, problems, self.penalty)

    def adopt(self, system: KernelSystem) -> None:
        """Solve a system that `kernel_system` made and use its solution."""
        if not isinstance(system, NystromSystem):
            raise DataError(f"falkon got a {type(system).__name__}; expected a system that `kernel_system` made")
        self._set(system.centers, system.solve(), system)

    def with_at_most(self, centers: int) -> Self:
        """Return an untrained head of the same configuration that chooses at most so many centers."""
        head = copy.copy(self)
        head.n_centers = min(self.n_centers, centers)
        head.centers = head.alpha = head._center_squares = head._system = None
        return head

    def partial_fit(self, X: torch.Tensor, Y: torch.Tensor, sample_weight: torch.Tensor | None = None) -> None:
        """Add samples X (n, d) to those fitted, centers unchanged; equals a fit on all of them with these centers.

        Y (n, t') may have more columns than before: the new problems take every earlier sample as a negative (-1).
        Before the first fit this is `fit`.

        Raises:
            ConfigError: When conjugate gradients were used, which keep no sums to add to.
        """
        if self.alpha is None:
            self.fit(X, Y, sample_weight)
            return
        if self._system is None:
            raise ConfigError("partial_fit needs solver='direct' and a head that was fitted in this process")
        check_training_set(X, Y, sample_weight, who="falkon")
        check_samples(X, self._system.centers.shape[1], who="falkon")
        known = self._system.problems
        if Y.shape[1] < known:
            raise ConfigError(f"partial_fit got {Y.shape[1]} problems; expected at least the {known} fitted")
        with fast_products(self.device):
            self._system.add_problems(Y.shape[1] - known)
            weight = None if sample_weight is None else sample_weight.to(self.device)
            self._system.add(X, Y.to(self.device), weight)
        self.adopt(self._system)

    def extend_centers(self, centers: torch.Tensor, X: torch.Tensor, Y: torch.Tensor) -> None:
        """Append centers to a fitted head; equals a fit on the same samples with all the centers.

        Only the new rows and columns of the normal equations are computed: n m (M + m) products, not n (M + m)^2.

        Args:
            centers: (m, d) further centers.
            X: (n, d) all samples so far, those of `partial_fit` included.
            Y: (n, t) their targets.

        Raises:
            ConfigError: When conjugate gradients were used, which keep no sums to add to.
            DataError: X is not as many samples as the head has seen; weights other than 1 cannot be extended.
        """
        if self._system is None:
            raise ConfigError("extend_centers needs solver='direct' and a head that was fitted in this process")
        check_training_set(X, Y, who="falkon")
        check_samples(X, self._system.centers.shape[1], who="falkon")
        check_samples(centers, self._system.centers.shape[1], who="falkon centers")
        if len(X) != self._system.weight or Y.shape[1] != self._system.problems:
            raise DataError(
                f"extend_centers got X {tuple(X.shape)} and Y {tuple(Y.shape)}; expected the {self._system.weight:g} "
                f"samples, each of weight 1, and {self._system.problems} problems that were fitted"
            )
        with fast_products(self.device):
            self._system.extend_centers(centers, X, Y.to(self.device))
        self.adopt(self._system)

    @clocked
    def decision_function(self, X: torch.Tensor) -> torch.Tensor:
        """Return scores (n, t) of X (n, d), on X's device."""
        centers, alpha = self._fitted()
        check_samples(X, centers.shape[1], who="falkon")
        scores = torch.empty(len(X), alpha.shape[1], dtype=alpha.dtype, device=X.device)
        with fast_products(self.device):
            for block in row_blocks(len(X), len(centers), centers.element_size()):
                K = self.kernel(X[block].to(centers), centers, self._center_squares)
                scores[block] = (K @ alpha).to(X.device)
        return scores

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return centers (M, d) and coefficients alpha (M, t)."""
        centers, alpha = self._fitted()
        return {"centers": centers.cpu(), "alpha": alpha.cpu()}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Load centers and coefficients."""
        if set(state) != {"centers", "alpha"}:
            raise CheckpointError(f"falkon: the state has {sorted(state)}; expected ['alpha', 'centers']")
        centers, alpha = state["centers"], state["alpha"]
        if centers.ndim != 2 or alpha.ndim != 2 or len(centers) != len(alpha):
            raise CheckpointError(
                f"falkon: centers {tuple(centers.shape)} and alpha {tuple(alpha.shape)}; expected (M, d) and (M, t)"
            )
        self._set(centers.to(self.device, copy=True), alpha.to(self.device, copy=True), None)

    def _use_conjugate_gradients(self, n: int, M: int, problems: int) -> bool:
        if self.solver == "auto":
            return is_cheaper_than_direct(n, M, problems)
        return self.solver == "conjugate_gradients"

    def _set(self, centers: torch.Tensor, alpha: torch.Tensor, system: NystromSystem | None) -> None:
        # one memory layout for solved and for loaded coefficients: their scores agree to the last bit
        self.centers, self.alpha, self._system = centers.contiguous(), alpha.contiguous(), system
        self._center_squares = squares(centers)

    def _fitted(self) -> tuple[torch.Tensor, torch.Tensor]:
        if self.centers is None or self.alpha is None:
            raise NotFittedError("falkon was asked for scores before it was fitted")
        return self.centers, self.alpha
