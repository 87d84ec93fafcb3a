"""Gaussian-process surrogate of an expensive, noisy objective over the unit cube (gpytorch).

Matern-5/2 kernel with one length scale per dimension under the log-normal prior that scales with the
dimension (Hvarfner et al. 2024, "Vanilla Bayesian Optimization Performs Great in High Dimensions"), a
constant mean, standardised outcomes, and two noise terms: the known variance of each observation, and one
learnt variance for what the reported standard errors leave out, such as the seed of a fine-tune.
"""

from __future__ import annotations

import logging
import math
import warnings
from dataclasses import dataclass
from typing import cast

import gpytorch
import numpy as np
import torch
from gpytorch.constraints import GreaterThan
from gpytorch.distributions import MultivariateNormal
from gpytorch.kernels import MaternKernel
from gpytorch.likelihoods import FixedNoiseGaussianLikelihood
from gpytorch.means import ConstantMean
from gpytorch.priors import LogNormalPrior
from scipy.optimize import minimize

from codesign_bo.space import Array

logger = logging.getLogger(__name__)

_NOISE_PRIOR = (-4.0, 1.0)  # log-normal, of the extra variance of standardised outcomes
_MIN_NOISE = 1e-5
_MIN_LENGTHSCALE = 2.5e-2
_STARTS = 3
_MAX_STARTS = 8


class MaternGP(gpytorch.models.ExactGP):
    """The model in unit cube and standardised outcomes; all tensors are float64.

    Args:
        x: Observed points (n, dim).
        y: Standardised outcomes (n,).
        variance: Known variance of each outcome (n,).
    """

    def __init__(self, x: torch.Tensor, y: torch.Tensor, variance: torch.Tensor) -> None:
        dim = x.shape[-1]
        location, scale = math.sqrt(2) + 0.5 * math.log(dim), math.sqrt(3)
        noise = FixedNoiseGaussianLikelihood(
            noise=variance.clamp_min(1e-6),
            learn_additional_noise=True,
            noise_prior=LogNormalPrior(*_NOISE_PRIOR),
            noise_constraint=GreaterThan(_MIN_NOISE),
        )
        super().__init__(x, y, noise)
        self.x = x
        self.y = y
        self.noise = noise
        self.mean = ConstantMean()
        self.kernel = MaternKernel(
            nu=2.5,
            ard_num_dims=dim,
            lengthscale_prior=LogNormalPrior(location, scale),
            lengthscale_constraint=GreaterThan(_MIN_LENGTHSCALE),
        )
        self.prior_location = location
        self.prior_scale = scale
        self.to(torch.float64)

    def forward(self, x: torch.Tensor) -> MultivariateNormal:
        """Return the prior at x (..., m, dim)."""
        return MultivariateNormal(cast(torch.Tensor, self.mean(x)), self.kernel(x))

    def posterior(self, x: torch.Tensor) -> MultivariateNormal:
        """Return the posterior of the noise-free function at x (..., m, dim), in evaluation mode."""
        return cast(MultivariateNormal, self(x))

    def observed(self) -> MultivariateNormal:
        """Return the prior of the observations, noise included."""
        return cast(MultivariateNormal, self.noise(self.forward(self.x)))

    @property
    def extra_variance(self) -> float:
        """Learnt variance of standardised outcomes beyond the known one."""
        return torch.as_tensor(self.noise.second_noise).item()

    def start_at(self, lengthscale: Array, extra_variance: float) -> None:
        """Set the hyperparameters: length scales (dim,) and extra variance."""
        self.kernel.lengthscale = torch.as_tensor(lengthscale).clamp_min(1.1 * _MIN_LENGTHSCALE)
        self.noise.initialize(**{"second_noise_covar.noise": torch.tensor(max(extra_variance, 1.1 * _MIN_NOISE))})
        self.mean.initialize(constant=0.0)

    def start_at_mode(self) -> None:
        """Set the hyperparameters to where the prior of the length scales peaks."""
        mode = math.exp(self.prior_location - self.prior_scale**2)
        self.start_at(np.full(self.x.shape[-1], mode), math.exp(_NOISE_PRIOR[0]))

    def start_at_draw(self, rng: np.random.Generator) -> None:
        """Draw the hyperparameters from their prior."""
        draw = rng.lognormal(self.prior_location, self.prior_scale, self.x.shape[-1])
        self.start_at(draw, float(rng.lognormal(*_NOISE_PRIOR)))


@dataclass(frozen=True)
class Surrogate:
    """A fitted surrogate.

    Attributes:
        x: Observed points (n, dim) of the unit cube.
        y: Observed means (n,), in the objective's unit.
        sem: Known standard errors (n,), 0 where unknown.
        gp: The model, in evaluation mode.
        shift: Mean of `y`.
        scale: Standard deviation of `y`, by which the model's outcomes were divided.
        fit: How the hyperparameters came about: `"map"`, or `"prior"` when no fit succeeded.
    """

    x: Array
    y: Array
    sem: Array
    gp: MaternGP
    shift: float
    scale: float
    fit: str

    @property
    def lengthscales(self) -> Array:
        """Length scales (dim,) in unit-cube units; one far above 1 means little effect or little data."""
        return self.gp.kernel.lengthscale.detach().numpy().reshape(-1).copy()

    @property
    def extra_noise(self) -> float:
        """Standard deviation of the noise learnt beyond `sem`, in the objective's unit."""
        return self.scale * math.sqrt(self.gp.extra_variance)

    def predict(self, points: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation of the noise-free objective.

        Args:
            points: Points (m, dim) of the unit cube.

        Returns:
            Mean (m,) and standard deviation (m,), in the objective's unit.
        """
        with torch.no_grad(), gpytorch.settings.debug(False):
            posterior = self.gp.posterior(torch.as_tensor(points, dtype=torch.float64))
            mean, variance = posterior.mean.numpy(), posterior.variance.numpy()
        return self.shift + self.scale * mean, self.scale * np.sqrt(variance)


def fit_surrogate(x: Array, y: Array, sem: Array, seed: int) -> Surrogate:
    """Fit by maximum a posteriori, from several starts, and never fail.

    The ladder: L-BFGS from the prior's mode and from draws of the prior, the best of three fits wins;
    fits that raise or diverge are replaced by further draws; if all fail, the prior's mode is used.

    Args:
        x: Points (n, dim) of the unit cube, n >= 1.
        y: Means (n,), finite.
        sem: Standard errors (n,), NaN where unknown (the learnt noise then stands alone).
        seed: Seed of the starting points; same data and seed give the same surrogate.
    """
    sem = np.nan_to_num(np.asarray(sem, dtype=float), nan=0.0)
    y = np.asarray(y, dtype=float)
    spread = float(np.std(y, ddof=1)) if len(y) > 1 else 0.0
    shift = float(np.mean(y))
    scale = spread if spread > 1e-12 * max(1.0, abs(shift)) else 1.0
    gp = MaternGP(*(torch.as_tensor(np.array(a)) for a in (x, (y - shift) / scale, (sem / scale) ** 2)))
    fits: list[tuple[float, dict[str, torch.Tensor]]] = []
    rng = np.random.default_rng(seed)
    for attempt in range(_MAX_STARTS):
        if attempt == 0:
            gp.start_at_mode()
        else:
            gp.start_at_draw(rng)
        loss = _minimise(gp)
        if math.isfinite(loss):
            fits.append((loss, {k: v.clone() for k, v in gp.state_dict().items()}))
        if len(fits) == _STARTS:
            break
    if fits:
        gp.load_state_dict(min(fits, key=lambda item: item[0])[1])
    else:
        logger.warning("no fit of the surrogate succeeded on %d points; using the prior's mode", len(y))
        gp.start_at_mode()
    gp.eval()
    return Surrogate(np.array(x), y, sem, gp, shift, scale, "map" if fits else "prior")


def _minimise(gp: MaternGP) -> float:
    """Minimise the negative log posterior from where `gp` stands; return it, or inf on failure."""
    gp.train()
    mll = gpytorch.mlls.ExactMarginalLogLikelihood(gp.noise, gp)
    weights = [p for p in gp.parameters() if p.requires_grad]

    def negative(flat: Array) -> tuple[float, Array]:
        torch.nn.utils.vector_to_parameters(torch.as_tensor(flat), weights)
        gp.zero_grad()
        loss = -cast(torch.Tensor, mll(gp(gp.x), gp.y))
        loss.backward()
        gradient = [torch.zeros_like(w) if w.grad is None else w.grad for w in weights]
        return loss.item(), torch.cat([g.reshape(-1) for g in gradient]).numpy()

    start = torch.nn.utils.parameters_to_vector(weights).detach().numpy().copy()
    try:
        with warnings.catch_warnings(), gpytorch.settings.fast_computations(log_prob=False):
            warnings.simplefilter("ignore")
            result = minimize(negative, start, jac=True, method="L-BFGS-B", options={"maxiter": 200})
            loss, _ = negative(result.x)
    except (RuntimeError, ValueError) as error:  # linear_operator's NotPSDError is a RuntimeError
        logger.info("a fit of the surrogate failed: %s", error)
        return math.inf
    return loss if math.isfinite(loss) else math.inf


@dataclass(frozen=True)
class LeaveOneOut:
    """Each observation predicted from all the others, hyperparameters held.

    Attributes:
        y: Observed means (n,).
        mean: Predicted means (n,).
        std: Predicted standard deviations (n,), observation noise included.
    """

    y: Array
    mean: Array
    std: Array

    @property
    def z(self) -> Array:
        """Standardised errors (n,); standard normal if the surrogate is calibrated."""
        return (self.y - self.mean) / self.std

    @property
    def coverage(self) -> float:
        """Fraction of observations inside their 95 % interval."""
        return float(np.mean(np.abs(self.z) <= 1.959964))

    @property
    def r2(self) -> float:
        """Share of the variance that is predicted; at most 0 where the surrogate knows no better."""
        total = float(np.sum((self.y - self.y.mean()) ** 2))
        return 1.0 - float(np.sum((self.y - self.mean) ** 2)) / total if total > 0 else 0.0


def leave_one_out(surrogate: Surrogate) -> LeaveOneOut:
    """Return the leave-one-out predictions (Rasmussen & Williams 2006, eqs. 5.10 to 5.12)."""
    gp = surrogate.gp
    with torch.no_grad():
        prior = gp.observed()
        inverse = torch.linalg.inv(prior.covariance_matrix)
        variance = 1.0 / inverse.diagonal()
        mean = gp.y - (inverse @ (gp.y - prior.mean)) * variance
    return LeaveOneOut(
        surrogate.y,
        surrogate.shift + surrogate.scale * mean.numpy(),
        surrogate.scale * variance.sqrt().numpy(),
    )


def slices(surrogate: Surrogate, point: Array, n: int) -> tuple[Array, Array, Array]:
    """Evaluate the posterior on lines through a point, one along each axis of the unit cube.

    Args:
        surrogate: The surrogate.
        point: Point (dim,) that all lines pass through.
        n: Number of points per line, spread evenly over [0, 1].

    Returns:
        Positions (n,) along a line, mean (dim, n) and standard deviation (dim, n).
    """
    dim = len(point)
    positions = np.linspace(0.0, 1.0, n)
    lines = np.tile(np.asarray(point, dtype=float), (dim, n, 1))
    for axis in range(dim):
        lines[axis, :, axis] = positions
    mean, std = surrogate.predict(lines.reshape(-1, dim))
    return positions, mean.reshape(dim, n), std.reshape(dim, n)
