"""Problems with a known optimum for `benchmarks/bo.py`, all to be maximised; fixed before anything was tuned on them.

Regret is `Problem.best` minus the noise-free value of the recommended design. The nominal design of a run is drawn at
random: the middle of the box would give a hint to those that start there (Levy's optimum is at 0.55 of each axis).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from codesign_bo import BoxSpace
from codesign_bo.space import Value
from numpy.typing import NDArray

Array = NDArray[np.float64]

_HARTMANN_ALPHA = np.array([1.0, 1.2, 3.0, 3.2])
_HARTMANN_A = np.array(
    [[10, 3, 17, 3.5, 1.7, 8], [0.05, 10, 17, 0.1, 8, 14], [3, 3.5, 1.7, 10, 17, 8], [17, 8, 0.05, 10, 0.1, 14]]
)
_HARTMANN_P = 1e-4 * np.array(
    [
        [1312, 1696, 5569, 124, 8283, 5886],
        [2329, 4135, 8307, 3736, 1004, 9991],
        [2348, 1451, 3522, 2883, 3047, 6650],
        [4047, 8828, 8732, 5743, 1091, 381],
    ]
)


def _no_noise(x: Array) -> float:
    return 0.0


def _everywhere(x: Array) -> bool:
    return True


class Score(NamedTuple):
    """What an evaluation reports: a mean, NaN for a failure, and its standard error."""

    mean: float
    sem: float | None


@dataclass(frozen=True)
class Problem:
    """A function to be maximised over a box.

    Attributes:
        name: Of the problem.
        parameters: Names of its d parameters.
        low: Lower bound of all of them.
        high: Upper bound.
        value: Maps designs (..., d) to noise-free values (...).
        best: Its highest value in the box.
        best_design: Where that is, (d,).
        noise: Maps a design (d,) to the standard deviation of its scores.
        sem: Maps a design (d,) to the standard error that is reported with a score.
        feasible: Whether a design (d,) has a score; where not, every evaluation fails.
    """

    name: str
    parameters: tuple[str, ...]
    low: float
    high: float
    value: Callable[[Array], Array]
    best: float
    best_design: tuple[float, ...]
    noise: Callable[[Array], float] = _no_noise
    sem: Callable[[Array], float] = _no_noise
    feasible: Callable[[Array], bool] = _everywhere

    def space(self, seed: int) -> BoxSpace:
        """The box, with a nominal design that is random and belongs to this seed."""
        rng = np.random.default_rng((seed, 1))
        nominal = rng.uniform(self.low, self.high, len(self.parameters)).tolist()
        return BoxSpace.box(self.parameters, self.low, self.high, nominal)

    def design(self, params: Mapping[str, Value]) -> Array:
        """A design by name as an array (d,)."""
        return np.array([float(params[name]) for name in self.parameters])

    def evaluate(self, params: Mapping[str, Value], draw: float) -> Score:
        """The score of a design, given a standard normal draw for its noise."""
        x = self.design(params)
        if not self.feasible(x):
            return Score(math.nan, None)
        return Score(float(self.value(x)) + self.noise(x) * draw, self.sem(x))

    def regret(self, params: Mapping[str, Value]) -> float:
        """How much worse the noise-free value of a design is than the best one; infinite where it has none."""
        x = self.design(params)
        return self.best - float(self.value(x)) if self.feasible(x) else math.inf


def hartmann4(x: Array) -> Array:
    """Hartmann's four-dimensional function on [0, 1]^4, rescaled and negated (Picheny et al. 2013).

    (sum_i alpha_i exp(-sum_j A_ij (x_j - P_ij)^2) - 1.1) / 0.839, with the first four columns of A and P.
    """
    return (_hartmann(x, 4) - 1.1) / 0.839


def hartmann4_noise(x: Array) -> float:
    """Standard deviation of the noise on `hartmann4`: 0.1 + 0.4 x_1."""
    return 0.1 + 0.4 * float(x[0])


def hartmann6(x: Array) -> Array:
    """Hartmann's six-dimensional function on [0, 1]^6, negated: sum_i alpha_i exp(-sum_j A_ij (x_j - P_ij)^2)."""
    return _hartmann(x, 6)


def _hartmann(x: Array, dim: int) -> Array:
    gaps = x[..., None, :] - _HARTMANN_P[:, :dim]
    return np.exp(-np.sum(_HARTMANN_A[:, :dim] * gaps**2, axis=-1)) @ _HARTMANN_ALPHA


def ackley(x: Array) -> Array:
    """Ackley's function, negated: 20 exp(-0.2 sqrt(mean(x^2))) + exp(mean(cos(2 pi x))) - 20 - e."""
    bowl = 20.0 * np.exp(-0.2 * np.sqrt(np.mean(x**2, axis=-1)))
    return bowl + np.exp(np.mean(np.cos(2.0 * np.pi * x), axis=-1)) - 20.0 - math.e


def levy(x: Array) -> Array:
    """Levy's function, negated, with w = 1 + (x - 1) / 4.

    -[sin^2(pi w_1) + sum_{i<d} (w_i - 1)^2 (1 + 10 sin^2(pi w_i + 1)) + (w_d - 1)^2 (1 + sin^2(2 pi w_d))]
    """
    w = 1.0 + (x - 1.0) / 4.0
    inner = w[..., :-1]
    waves = np.sum((inner - 1.0) ** 2 * (1.0 + 10.0 * np.sin(np.pi * inner + 1.0) ** 2), axis=-1)
    last = (w[..., -1] - 1.0) ** 2 * (1.0 + np.sin(2.0 * np.pi * w[..., -1]) ** 2)
    return -(np.sin(np.pi * w[..., 0]) ** 2 + waves + last)


def legs4(x: Array) -> Array:
    """A landscape of four leg lengths in [0.6, 1.4]: front thigh, front shank, hind thigh, hind shank.

    With f and h, how much longer than 1 the front and hind legs are on average (mean of thigh and shank), and
    a and b, how much longer their thigh is than their shank:

        r = h - (0.1 - 0.8 f + 1.2 f^2)
        ridge = 6 exp(-[(r / 0.1)^2 + ((f - 0.16) / 0.22)^2 + ((a + 0.1) / 0.35)^2 + ((b - 0.15) / 0.35)^2] / 2)
        small = 2.5 exp(-[((f + 0.2) / 0.1)^2 + ((h + 0.15) / 0.1)^2 + (a / 0.35)^2 + (b / 0.35)^2] / 2)
        value = 4 - 5 (f^2 + h^2) + ridge + small

    A longer front leg asks for a shorter hind leg along the curved ridge r = 0; small robots are a mild local optimum.
    """
    f, h, a, b = _legs(x)
    r = h - (0.1 - 0.8 * f + 1.2 * f**2)
    ridge = _bell(r / 0.1, (f - 0.16) / 0.22, (a + 0.1) / 0.35, (b - 0.15) / 0.35)
    small = _bell((f + 0.2) / 0.1, (h + 0.15) / 0.1, a / 0.35, b / 0.35)
    return 4.0 - 5.0 * (f**2 + h**2) + 6.0 * ridge + 2.5 * small


def legs4_sem(x: Array) -> float:
    """Reported standard error of `legs4`: 0.2 exp(1.5 (f + h)), for tall robots vary more between episodes."""
    f, h, _, _ = _legs(x)
    return 0.2 * math.exp(1.5 * float(f + h))


def legs4_noise(x: Array) -> float:
    """Standard deviation of the scores of `legs4`: the reported error, and 0.4 of the training's seed beside it."""
    return math.hypot(legs4_sem(x), 0.4)


def legs4_feasible(x: Array) -> bool:
    """Whether `legs4` has a score: f - h <= 0.25, or the robot stands nose up and tips over (a seventh of the box)."""
    f, h, _, _ = _legs(x)
    return bool(f - h <= 0.25)


def _legs(x: Array) -> tuple[Array, Array, Array, Array]:
    front_thigh, front_shank, hind_thigh, hind_shank = np.moveaxis(np.asarray(x, dtype=float), -1, 0)
    front, hind = (front_thigh + front_shank) / 2 - 1.0, (hind_thigh + hind_shank) / 2 - 1.0
    return front, hind, front_thigh - front_shank, hind_thigh - hind_shank


def _bell(*z: Array) -> Array:
    return np.exp(-0.5 * sum((each**2 for each in z), np.zeros(())))


def _axes(dim: int) -> tuple[str, ...]:
    return tuple(f"x{i + 1}" for i in range(dim))


PROBLEMS: dict[str, Problem] = {
    problem.name: problem
    for problem in (
        Problem(
            "noisy-hartmann4",
            _axes(4),
            0.0,
            1.0,
            hartmann4,
            3.1344941412,
            (0.1873952, 0.1941513, 0.5579179, 0.2647783),
            hartmann4_noise,
            hartmann4_noise,
        ),
        Problem("ackley4", _axes(4), -5.0, 10.0, ackley, 0.0, (0.0, 0.0, 0.0, 0.0)),
        Problem(
            "hartmann6",
            _axes(6),
            0.0,
            1.0,
            hartmann6,
            3.3223680114,
            (0.20168951, 0.15001069, 0.47687398, 0.27533243, 0.31165162, 0.65730053),
        ),
        Problem("levy4", _axes(4), -10.0, 10.0, levy, 0.0, (1.0, 1.0, 1.0, 1.0)),
        Problem(
            "legs4",
            ("front_thigh", "front_shank", "hind_thigh", "hind_shank"),
            0.6,
            1.4,
            legs4,
            9.8827354966,
            (1.0980017, 1.1979771, 1.0827031, 0.9327402),
            legs4_noise,
            legs4_sem,
            legs4_feasible,
        ),
    )
}
"""All problems, by name."""
