"""The Gaussian process behind the surrogate (gpytorch), in features and standardised outcomes.

Matern-5/2 kernel with one length scale per parameter and a learnt variance, a constant mean or one that
follows a trend, and two noise terms: the known variance of each observation, and one learnt variance for what
the reported standard errors leave out, such as the seed of a fine-tune.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import gpytorch
import numpy as np
import torch
from gpytorch.constraints import Positive
from gpytorch.distributions import MultivariateNormal
from gpytorch.kernels import Kernel
from gpytorch.likelihoods import FixedNoiseGaussianLikelihood
from gpytorch.means import ConstantMean

from codesign_bo.space import Array

Trend = Callable[[torch.Tensor], torch.Tensor]
"""Maps features (..., m, f) to what the objective is expected to follow there (..., m)."""

_SAME = 1e-20
_SMALLEST_NOISE = 1e-6


@dataclass(frozen=True)
class Hyperparameters:
    """What is learnt of the model.

    Attributes:
        lengthscales: Length scale of each parameter (dim,), in edges of the unit cube.
        variance: Variance of the standardised noise-free objective around its mean.
        extra_variance: Variance of the noise beyond the known one.
        constant: Mean of the objective.
        weight: Weight of the trend.
    """

    lengthscales: Array
    variance: float
    extra_variance: float
    constant: float = 0.0
    weight: float = 0.0


class Matern(Kernel):
    """Matern-5/2 over features, with a length scale for each parameter and a variance.

    Args:
        groups: To which parameter each of f features belongs (f,); those of a categorical share a length scale.
    """

    lengthscales: torch.Tensor
    variance: torch.Tensor

    def __init__(self, groups: Sequence[int]) -> None:
        super().__init__()
        self._groups = torch.as_tensor(groups)
        self.register_buffer("lengthscales", torch.ones(max(groups) + 1, dtype=torch.float64))
        self.register_buffer("variance", torch.ones((), dtype=torch.float64))

    def forward(
        self,
        x1: torch.Tensor,
        x2: torch.Tensor,
        diag: bool = False,
        last_dim_is_batch: bool = False,
        **params: object,
    ) -> torch.Tensor:
        """Return the covariance of x1 (..., m, f) and x2 (..., n, f), as (..., m, n), or (..., m) if `diag`."""
        if last_dim_is_batch:
            raise NotImplementedError("this kernel is no sum or product over features")
        scale = self.lengthscales[self._groups]
        x1, x2 = x1 / scale, x2 / scale
        gaps = x1 - x2 if diag else x1.unsqueeze(-2) - x2.unsqueeze(-3)
        r = (5.0 * gaps.square().sum(-1)).clamp_min(_SAME).sqrt()
        return self.variance * (1.0 + r + r.square() / 3.0) * torch.exp(-r)


class TrendMean(ConstantMean):
    """A constant plus a weighted trend."""

    weight: torch.Tensor

    def __init__(self, trend: Trend) -> None:
        super().__init__()
        self.trend = trend
        self.register_buffer("weight", torch.zeros((), dtype=torch.float64))

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """Return the prior mean (..., m) at features (..., m, f)."""
        return cast(torch.Tensor, self.constant) + self.weight * self.trend(input)


class MaternGP(gpytorch.models.ExactGP):
    """The model, in evaluation mode with its hyperparameters held; all tensors are float64.

    Args:
        x: Features of the observed points (n, f).
        y: Standardised outcomes (n,).
        variance: Known variance of each outcome (n,); replicates of a point are merged by it.
        groups: To which parameter each feature belongs (f,).
        trend: What the objective is expected to follow; None for nothing.
    """

    def __init__(
        self,
        x: torch.Tensor,
        y: torch.Tensor,
        variance: torch.Tensor,
        groups: Sequence[int],
        trend: Trend | None = None,
    ) -> None:
        known = variance.clamp_min(_SMALLEST_NOISE)
        noise = FixedNoiseGaussianLikelihood(known, learn_additional_noise=True, noise_constraint=Positive())
        super().__init__(x, y, noise)
        self.x = x
        self.y = y
        self.known = known
        self.groups = tuple(groups)
        self.noise = noise
        self.mean = ConstantMean() if trend is None else TrendMean(trend)
        self.kernel = Matern(groups)
        self.held: Hyperparameters | None = None
        self._factor: tuple[torch.Tensor, torch.Tensor] | None = None
        self.to(torch.float64).eval().requires_grad_(False)

    def forward(self, x: torch.Tensor) -> MultivariateNormal:
        """Return the prior at features x (..., m, f)."""
        return MultivariateNormal(cast(torch.Tensor, self.mean(x)), self.kernel(x))

    def hold(self, values: Hyperparameters) -> None:
        """Set the hyperparameters, and factorise for `moments`.

        Raises:
            RuntimeError: The covariance is not positive definite.
        """
        self.held, self._factor = values, None
        self.kernel.lengthscales.copy_(torch.as_tensor(values.lengthscales))
        self.kernel.variance.fill_(values.variance)
        self.noise.initialize(**{"second_noise_covar.noise": torch.tensor(values.extra_variance, dtype=torch.float64)})
        self.mean.initialize(constant=values.constant)
        if isinstance(self.mean, TrendMean):
            self.mean.weight.fill_(values.weight)
        with torch.no_grad():
            mean, covariance = self.observed()
            root = torch.linalg.cholesky(covariance)
            weights = torch.cholesky_solve((self.y - mean)[:, None], root)[:, 0]
        self._factor = (root, weights)

    def observed(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean (n,) and covariance (n, n) of the observations before any was made, noise included."""
        noise = self.known + torch.as_tensor(self.noise.second_noise)
        return cast(torch.Tensor, self.mean(self.x)), self.kernel.forward(self.x, self.x) + torch.diag(noise)

    def moments(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what the posterior of the noise-free objective is made of; differentiable in x.

        Args:
            x: Features (..., m, f).

        Returns:
            Mean (..., m), and V (..., n, m) with `covariance(a, b) = kernel(a, b) - V(a)^T V(b)`.
        """
        if self._factor is None:
            raise RuntimeError("hold() comes before moments()")
        root, weights = self._factor
        cross = self.kernel.forward(self.x, x)
        mean = cast(torch.Tensor, self.mean(x)) + (cross * weights[:, None]).sum(-2)
        return mean, torch.linalg.solve_triangular(root, cross, upper=False)

    def posterior(self, x: torch.Tensor) -> MultivariateNormal:
        """Return the posterior of the noise-free objective at features x (..., m, f)."""
        mean, v = self.moments(x)
        return MultivariateNormal(mean, self.kernel.forward(x, x) - v.mT @ v)

    def squared_gaps(self) -> Array:
        """Return the squared distances of observed points along each parameter (dim, n, n)."""
        gaps = (self.x[:, None] - self.x[None]).square().numpy()
        groups = np.array(self.groups)
        return np.stack([gaps[..., groups == i].sum(axis=-1) for i in range(groups.max() + 1)])
