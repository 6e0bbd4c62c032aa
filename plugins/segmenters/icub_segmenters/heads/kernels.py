"""Positive definite kernels, evaluated in blocks by one matrix product each."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch

from icub_core.errors import ConfigError, unknown_name


class Kernel(ABC):
    """k(x, y) for all pairs of two sets of samples."""

    @abstractmethod
    def __call__(
        self,
        X: torch.Tensor,
        Y: torch.Tensor,
        Y_squares: torch.Tensor | None = None,
        out: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Return the (n, m) kernel matrix of X (n, d) and Y (m, d).

        Args:
            X: Samples.
            Y: Samples, usually the centers.
            Y_squares: (m,) squared norms of Y, when the caller has them.
            out: (n, m) where to write it; fresh memory costs about as much as the exponential.
        """


def squares(X: torch.Tensor) -> torch.Tensor:
    """Return |x|^2 (n,) of X (n, d), without a temporary of X's size."""
    return torch.linalg.vector_norm(X, dim=1).square_()


def squared_distances(
    X: torch.Tensor, Y: torch.Tensor, Y_squares: torch.Tensor | None = None, out: torch.Tensor | None = None
) -> torch.Tensor:
    """Return |x - y|^2 (n, m), never negative; one product and two rank-one terms."""
    if Y_squares is None:
        Y_squares = squares(Y)
    distances = torch.addmm(Y_squares, X, Y.T, alpha=-2.0, out=out)
    distances += squares(X).unsqueeze(1)
    return distances.clamp_(min=0.0)


class Radial(Kernel):
    """A function of the Euclidean distance."""

    def __call__(
        self,
        X: torch.Tensor,
        Y: torch.Tensor,
        Y_squares: torch.Tensor | None = None,
        out: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Return the (n, m) kernel matrix."""
        return self._of_squares(squared_distances(X, Y, Y_squares, out))

    @abstractmethod
    def _of_squares(self, distances: torch.Tensor) -> torch.Tensor:
        """Turn squared distances (n, m) into kernel values, in place."""


class Gaussian(Radial):
    """exp(-|x - y|^2 / (2 sigma^2)); source: thesis 10.3.2, the kernel of all its heads."""

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma

    def _of_squares(self, distances: torch.Tensor) -> torch.Tensor:
        return distances.mul_(-0.5 / self.sigma**2).exp_()


class Laplacian(Radial):
    """exp(-|x - y| / sigma) with the Euclidean norm, as in the FALKON library (scikit-learn takes the 1-norm)."""

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma

    def _of_squares(self, distances: torch.Tensor) -> torch.Tensor:
        return distances.sqrt_().mul_(-1.0 / self.sigma).exp_()


class Linear(Kernel):
    """x . y / sigma^2."""

    def __init__(self, sigma: float = 1.0) -> None:
        self.sigma = sigma

    def __call__(
        self,
        X: torch.Tensor,
        Y: torch.Tensor,
        Y_squares: torch.Tensor | None = None,
        out: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Return the (n, m) kernel matrix."""
        return torch.mm(X, Y.T, out=out).mul_(1.0 / self.sigma**2)


KERNELS: dict[str, type[Gaussian] | type[Laplacian] | type[Linear]] = {
    "gaussian": Gaussian,
    "laplacian": Laplacian,
    "linear": Linear,
}


def make_kernel(name: str, sigma: float) -> Kernel:
    """Return the kernel called `name` with width `sigma`; ConfigError for another name or a width not above 0."""
    if name not in KERNELS:
        raise ConfigError(unknown_name("kernel", name, KERNELS))
    if not sigma > 0:
        raise ConfigError(f"sigma is {sigma}; expected a kernel width above 0")
    return KERNELS[name](sigma)
