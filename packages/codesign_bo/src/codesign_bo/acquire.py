"""Which point to evaluate next: noisy log expected improvement. The only module that uses BoTorch."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.acquisition.objective import GenericMCObjective
from botorch.models.gpytorch import GPyTorchModel
from botorch.optim import optimize_acqf
from botorch.optim.initializers import initialize_q_batch
from botorch.sampling.normal import SobolQMCNormalSampler
from gpytorch.distributions import MultivariateNormal

from codesign_bo.space import Array, BoxSpace, Feasible, is_feasible, sobol_points
from codesign_bo.surrogate import Surrogate

_QMC_SAMPLES = 256
_RAW_POINTS = 512
_LOCAL_POINTS = 128
_LOCAL_SPREAD = 0.05
_RESTARTS = 6


class _BotorchView(GPyTorchModel):
    """Lets BoTorch see the surrogate's model."""

    def __init__(self, surrogate: Surrogate) -> None:
        super().__init__()
        self.gp = surrogate.gp
        self.likelihood = surrogate.gp.noise

    @property
    def num_outputs(self) -> int:
        return 1

    @property
    def batch_shape(self) -> torch.Size:
        return torch.Size()

    def forward(self, x: torch.Tensor) -> MultivariateNormal:
        return self.gp.posterior(x)


def noisy_log_ei(
    surrogate: Surrogate, pending: Array, seed: int, maximize: bool = True
) -> qLogNoisyExpectedImprovement:
    """Return the acquisition function (Ament et al. 2023, "Unexpected Improvements to EI for BO").

    Args:
        surrogate: The surrogate; every point it has observed may be the true best.
        pending: Points (m, dim) under evaluation; improvement is counted beyond what they may bring.
        seed: Seed of the quasi-Monte Carlo samples.
        maximize: Whether the objective is to be maximised.

    Returns:
        A function of points (b, 1, dim) with values (b,), in log units of standardised outcomes.
    """
    sign = 1.0 if maximize else -1.0
    return qLogNoisyExpectedImprovement(
        model=_BotorchView(surrogate),
        X_baseline=torch.as_tensor(surrogate.x),
        sampler=SobolQMCNormalSampler(torch.Size([_QMC_SAMPLES]), seed=seed),
        objective=GenericMCObjective(lambda samples, X=None: sign * samples[..., 0]),
        X_pending=torch.as_tensor(pending) if len(pending) else None,
        prune_baseline=True,
    )


def suggest(
    space: BoxSpace,
    surrogate: Surrogate,
    pending: Array,
    seed: int,
    maximize: bool = True,
    feasible: Feasible | None = None,
) -> Array:
    """Return the feasible point (dim,) of the unit cube with the highest noisy log expected improvement.

    The same arguments give the same point; the global random state is neither read nor changed.

    Args:
        space: The space, for the feasibility predicate.
        surrogate: Fitted to all evaluated points.
        pending: Points (m, dim) under evaluation.
        seed: Seed of sampling and restarts.
        maximize: Whether the objective is to be maximised.
        feasible: Predicate over designs in natural units.

    Raises:
        StudyError: No feasible point was found.
    """
    with _reproducible(seed):
        acquisition = noisy_log_ei(surrogate, pending, seed, maximize)
        raw = torch.as_tensor(_raw_points(space, surrogate, seed, maximize, feasible)).unsqueeze(-2)
        with torch.no_grad():
            values = acquisition(raw)
        starts, start_values = initialize_q_batch(raw, values, n=_RESTARTS)
        ends, end_values = optimize_acqf(
            acquisition,
            bounds=torch.tensor([[0.0], [1.0]], dtype=torch.float64).expand(2, space.dim),
            q=1,
            num_restarts=_RESTARTS,
            batch_initial_conditions=starts,
            return_best_only=False,
            options={"maxiter": 100},
        )
    assert end_values is not None
    # Restarts are feasible but may climb out of the feasible set; then the best start stands.
    points = torch.cat([ends, starts]).squeeze(-2).numpy()
    scores = torch.cat([end_values, start_values]).detach().numpy().copy()
    scores[~np.isfinite(scores) | ~is_feasible(space, points, feasible)] = -np.inf
    return points[int(np.argmax(scores))]


def _raw_points(space: BoxSpace, surrogate: Surrogate, seed: int, maximize: bool, feasible: Feasible | None) -> Array:
    """Return feasible points (n, dim): some all over the cube, some around the best observed point."""
    spread = sobol_points(space, _RAW_POINTS, seed, feasible)
    mean, _ = surrogate.predict(surrogate.x)
    centre = surrogate.x[int(np.argmax(mean if maximize else -mean))]
    noise = np.random.default_rng(seed).normal(0.0, _LOCAL_SPREAD, (_LOCAL_POINTS, space.dim))
    local = np.clip(centre + noise, 0.0, 1.0)
    return np.concatenate([spread, local[is_feasible(space, local, feasible)]])


@contextmanager
def _reproducible(seed: int) -> Iterator[None]:
    """Seed torch, use one thread (sums in one order, and small matrices are faster), then restore both."""
    threads = torch.get_num_threads()
    state = torch.random.get_rng_state()
    torch.set_num_threads(1)
    torch.default_generator.manual_seed(seed)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        torch.random.set_rng_state(state)
        torch.set_num_threads(threads)
