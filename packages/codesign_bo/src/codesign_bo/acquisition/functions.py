"""How much is to be gained by evaluating a point: noisy log expected improvement, of a value or of a hypervolume.

The noise-free objective is drawn at the points that may be the best so far, and at those under evaluation.
Given a draw, the objective elsewhere is normal, so the expected improvement over that draw is a formula; the
mean over draws is the noisy expected improvement (Letham et al. 2019, "Constrained Bayesian Optimization
with Noisy Experiments"), here in logarithms (Ament et al. 2023, "Unexpected Improvements to Expected
Improvement"). Where objectives compete, improvement is of the dominated hypervolume, cell by cell (Yang et
al. 2019, "Efficient Computation of Expected Hypervolume Improvement").
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from botorch.utils.multi_objective.box_decompositions.non_dominated import FastNondominatedPartitioning
from botorch.utils.sampling import draw_sobol_normal_samples

from codesign_bo.models.surrogate import Surrogate
from codesign_bo.space import Array

Acquisition = Callable[[torch.Tensor], torch.Tensor]
"""Maps points (b, dim) of the unit cube to their worth (b,), in log units; differentiable."""

_DRAWS = 64
_PRUNING_DRAWS = 512
_JITTER = 1e-6
_SMALLEST_STD = 1e-9
_FAR = 1e6


@dataclass(frozen=True)
class Objective:
    """A surrogate and which way is better."""

    surrogate: Surrogate
    maximize: bool = True

    @property
    def sign(self) -> float:
        """1 if higher is better, otherwise -1."""
        return 1.0 if self.maximize else -1.0


class Fantasies:
    """Draws of a noise-free objective at some points, and what each draw implies elsewhere.

    Everything is in standardised outcomes, signed so that more is better.

    Args:
        objective: The objective.
        points: The points (k, dim).
        draws: Number of draws s.
        seed: Seed of the quasi-Monte Carlo draws.
    """

    def __init__(self, objective: Objective, points: torch.Tensor, draws: int, seed: int) -> None:
        self._gp, self._features = objective.surrogate.gp, objective.surrogate.features
        self._sign = objective.sign
        with torch.no_grad():
            self._x = self._features(points)
            mean, self._v = self._gp.moments(self._x)
            self._root = _root(self._gp.kernel.forward(self._x, self._x) - self._v.mT @ self._v)
            normal = draw_sobol_normal_samples(len(points), draws, dtype=torch.float64, seed=seed)
            self.values = self._sign * (mean + normal @ self._root.mT)
            """Drawn values (s, k)."""
            # L^-T z: times the covariance with another point, it is the shift of the mean there
            self._weights = torch.linalg.solve_triangular(self._root.mT, normal.mT, upper=True)

    def __call__(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the mean (b, s) under each draw, and the standard deviation (b, 1), at points (b, dim)."""
        x = self._features(points)
        mean, v = self._gp.moments(x)
        cross = self._gp.kernel.forward(self._x, x) - self._v.mT @ v
        half = torch.linalg.solve_triangular(self._root, cross, upper=False)
        variance = self._gp.kernel.variance - v.square().sum(0) - half.square().sum(0)
        means = self._sign * (mean[:, None] + cross.mT @ self._weights)
        return means, variance.clamp_min(_SMALLEST_STD**2).sqrt()[:, None]


def noisy_log_ei(objective: Objective, pending: Array, seed: int, draws: int = _DRAWS) -> Acquisition:
    """Return the logarithm of the noisy expected improvement.

    Args:
        objective: What is to be improved; every point it was observed at may be the true best.
        pending: Points (m, dim) under evaluation; improvement is counted beyond what they may bring.
        seed: Seed of the draws.
        draws: Number of draws.

    Returns:
        The acquisition, in log units of standardised outcomes.
    """
    observed = torch.unique(torch.as_tensor(objective.surrogate.x), dim=0)
    first = Fantasies(objective, observed, _PRUNING_DRAWS, seed).values
    plausible = observed[torch.unique(first.argmax(dim=1))]
    points = torch.cat([plausible, torch.as_tensor(pending).reshape(-1, observed.shape[1])])
    fantasies = Fantasies(objective, points, draws, seed)
    best = fantasies.values.amax(dim=1)

    def value(at: torch.Tensor) -> torch.Tensor:
        mean, std = fantasies(at)
        return (std.log() + log_ei((mean - best) / std)).logsumexp(dim=1) - math.log(draws)

    return value


def noisy_log_ehvi(
    objectives: Sequence[Objective], reference: Array, pending: Array, seed: int, draws: int = _DRAWS
) -> Acquisition:
    """Return the logarithm of the noisy expected hypervolume improvement; objectives are independent.

    Args:
        objectives: At least two, all observed at the same points.
        reference: What a design must surpass in each objective to count (m,), in the objectives' units.
        pending: Points (m, dim) under evaluation; improvement is counted beyond what they may bring.
        seed: Seed of the draws.
        draws: Number of draws.

    Returns:
        The acquisition, in log units of standardised outcomes.
    """
    observed = torch.unique(torch.cat([torch.as_tensor(o.surrogate.x) for o in objectives]), dim=0)
    points = torch.cat([observed, torch.as_tensor(pending).reshape(-1, observed.shape[1])])
    fantasies = [Fantasies(o, points, draws, seed + i) for i, o in enumerate(objectives)]
    floor = torch.tensor(
        [o.sign * (r - o.surrogate.shift) / o.surrogate.scale for o, r in zip(objectives, reference, strict=True)],
        dtype=torch.float64,
    )
    low, high = _cells(torch.stack([f.values for f in fantasies], dim=-1), floor)

    def value(at: torch.Tensor) -> torch.Tensor:
        logs = torch.zeros((), dtype=torch.float64)
        for i, f in enumerate(fantasies):
            mean, std = f(at)
            mean, std = mean[..., None], std[..., None]
            above, beyond = (std.log() + log_ei((mean - edge[..., i]) / std) for edge in (low, high))
            logs = logs + above + _log1mexp((above - beyond).clamp_min(1e-15))
        return logs.logsumexp(dim=(1, 2)) - math.log(draws)

    return value


def _cells(values: torch.Tensor, floor: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Split what each draw's Pareto front leaves undominated into cells.

    Args:
        values: Draws (s, k, m).
        floor: Reference point (m,).

    Returns:
        Lower and upper corners (s, c, m); draws with fewer cells have empty ones, far away.
    """
    corners = [FastNondominatedPartitioning(ref_point=floor, Y=draw).get_hypercell_bounds() for draw in values]
    most = max(low.shape[0] for low, _ in corners)
    low, high = (torch.full((len(corners), most, len(floor)), _FAR, dtype=torch.float64) for _ in range(2))
    for i, (a, b) in enumerate(corners):
        low[i, : len(a)], high[i, : len(b)] = a, b.clamp_max(_FAR)
    return low, high


def log_ei(u: torch.Tensor) -> torch.Tensor:
    """Return log(phi(u) + u Phi(u)), exact far into the tail: E[(u + Z)+] for a standard normal Z."""
    near = u.clamp_min(-1.0)
    far = u.clamp(-1e5, -1.0)
    plain = (torch.exp(_log_density(near)) + near * torch.special.ndtr(near)).log()
    scaled = -math.sqrt(0.5 * math.pi) * far * torch.special.erfcx(-far / math.sqrt(2.0))
    # beyond 1e5 the rest of the continued fraction is below rounding
    tail = torch.where(u < -1e5, -2.0 * (-u.clamp_max(-1.0)).log(), torch.log1p(-scaled))
    return torch.where(u > -1.0, plain, _log_density(u.clamp_max(-1.0)) + tail)


def _log_density(u: torch.Tensor) -> torch.Tensor:
    return -0.5 * u.square() - 0.5 * math.log(2.0 * math.pi)


def _log1mexp(x: torch.Tensor) -> torch.Tensor:
    """Return log(1 - exp(-x)) for x > 0."""
    small = x.clamp_max(math.log(2.0))
    large = x.clamp_min(math.log(2.0))
    return torch.where(x < math.log(2.0), (-torch.expm1(-small)).log(), torch.log1p(-torch.exp(-large)))


def _root(covariance: torch.Tensor) -> torch.Tensor:
    """Return the Cholesky factor, with just enough added to the diagonal."""
    jitter = _JITTER * covariance.diagonal().mean().clamp_min(1e-12)
    for _ in range(6):
        root, failed = torch.linalg.cholesky_ex(covariance + jitter * torch.eye(len(covariance), dtype=torch.float64))
        if not failed.item():
            return root
        jitter = 10.0 * jitter
    raise RuntimeError("the covariance of the best designs so far is not positive definite")
