"""How the defaults of codesign_bo's surrogate were chosen: variants on the same problems, seeds and noise.

The seeds are not those of `benchmarks/bo.py`, and two further problems keep the choice from being made for its five
alone. Runs call the same functions as a study does, without its file. Prints, for each variant and problem, the median
regret, and the mean over seeds of the logarithm of regret less that of the first variant, with its standard error.

    python benchmarks/bo_defaults.py --seeds 10
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
if __name__ == "__main__":
    sys.path[0] = str(ROOT)  # not the folder of this file: it has a morphgen.py, which `import morphgen` would find
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np
import tyro
from codesign_bo.acquisition.functions import Objective
from codesign_bo.acquisition.proposal import Belief, propose
from codesign_bo.data import Viability
from codesign_bo.models.priors import PRIORS, Gamma, LogNormal, Priors
from codesign_bo.models.surrogate import fit_surrogate
from codesign_bo.models.viability import fit_viability
from codesign_bo.seeds import derive_seed
from numpy.typing import NDArray

from benchmarks.bo_problems import PROBLEMS, Problem

FIRST_SEED = 1000
_FLOOR = 1e-3


def rosenbrock(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rosenbrock's function, negated and on a logarithmic scale: a curved valley."""
    steep = 100.0 * (x[..., 1:] - x[..., :-1] ** 2) ** 2
    return -np.log1p(np.sum(steep + (1.0 - x[..., :-1]) ** 2, axis=-1))


def styblinski_tang(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Styblinski and Tang's function, negated: sixteen optima of different height in four dimensions."""
    return -0.5 * np.sum(x**4 - 16.0 * x**2 + 5.0 * x, axis=-1)


_AXES = ("x1", "x2", "x3", "x4")
FURTHER = {
    problem.name: problem
    for problem in (
        Problem("rosenbrock4", _AXES, -2.0, 2.0, rosenbrock, 0.0, (1.0,) * 4, lambda x: 0.3, lambda x: 0.1),
        Problem("styblinski4", _AXES, -5.0, 5.0, styblinski_tang, 156.66466282, (-2.903534,) * 4),
    )
}


def _wide(dim: int) -> LogNormal:
    """Length scales that grow with the dimension (Hvarfner et al. 2024), the default of BoTorch."""
    return LogNormal(math.sqrt(2.0) + 0.5 * math.log(dim), math.sqrt(3.0))


_ONE, _FREE = None, LogNormal(0.0, 0.5)  # variance of the objective
_NOISY, _EXACT = LogNormal(-4.0, 1.0), Gamma(1.1, 30.0)  # extra variance of the noise; the latter allows none

_GAMMA = Gamma(3.0, 6.0)

VARIANTS: dict[str, tuple[Callable[[int], Priors], Callable[[int], int]]] = {
    "botorch": (lambda d: Priors(_wide(d), _ONE, _NOISY), lambda d: 2 * d),
    "gamma": (lambda d: Priors(_GAMMA, _ONE, _NOISY), lambda d: 2 * d),
    "gamma+scale": (lambda d: Priors(_GAMMA, _FREE, _NOISY), lambda d: 2 * d),
    "gamma+exact": (lambda d: Priors(_GAMMA, _ONE, _EXACT), lambda d: 2 * d),
    "gamma+scale+exact": (lambda d: Priors(_GAMMA, _FREE, _EXACT), lambda d: 2 * d),
    "wide+scale+exact": (lambda d: Priors(_wide(d), _FREE, _EXACT), lambda d: 2 * d),
    "early": (lambda d: Priors(_GAMMA, _FREE, _EXACT), lambda d: d + 1),
    "default": (lambda d: PRIORS, lambda d: 2 * d),
}
"""Priors and number of initial trials, by dimension."""


@dataclass(frozen=True)
class Defaults:
    """Options."""

    seeds: int = 10
    """Seeds 1000 to this more, less one."""
    evaluations: int = 30
    variants: tuple[str, ...] = tuple(VARIANTS)
    problems: tuple[str, ...] = (*PROBLEMS, *FURTHER)
    log: Path = ROOT / "runs" / "bo" / "defaults.jsonl"
    """Where finished runs are kept; remove it after a change of the code."""


def run(variant: str, problem: Problem, seed: int, evaluations: int) -> float:
    """Return the regret of the recommended design after a search without a file."""
    priors, initial = VARIANTS[variant]
    space = problem.space(seed)
    draws = np.random.default_rng((seed, 0)).standard_normal(evaluations)
    designs, y, sem = [], np.full(evaluations, np.nan), np.full(evaluations, np.nan)

    def believe() -> tuple[Belief, NDArray[np.float64], NDArray[np.bool_]]:
        x, n = space.to_unit(space.designs(designs)), len(designs)
        ok = ~np.isnan(y[:n])
        fit_seed = derive_seed(seed, 0, 3)
        surrogate = fit_surrogate(x[ok], y[:n][ok], sem[:n][ok], fit_seed, space, priors=priors(space.dim))
        return Belief((Objective(surrogate),), fit_viability(space, Viability(x, ok))), x, ok

    nothing = np.empty((0, space.dim))
    for trial, draw in enumerate(draws):
        belief, failed = None, nothing
        if trial >= initial(space.dim) and np.isfinite(y[:trial]).sum() >= 2:
            belief, x, ok = believe()
            failed = x[~ok]
        designs.append(propose(space, trial, initial(space.dim), seed, belief, nothing, failed).params)
        score = problem.evaluate(designs[-1], draw)
        y[trial], sem[trial] = score.mean, np.nan if score.sem is None else score.sem
    belief, x, ok = believe()
    mean, _ = belief.objectives[0].surrogate.predict(x[ok])
    return problem.regret(designs[np.flatnonzero(ok)[int(np.argmax(mean))]])


def table(regrets: dict[tuple[str, str, int], float], variants: Iterable[str], problems: Iterable[str]) -> list[str]:
    """Return one line for each problem and variant."""
    first, *_ = variants
    lines = []
    for problem in problems:
        for variant in variants:
            seeds = [s for v, p, s in regrets if (v, p) == (variant, problem) and (first, p, s) in regrets]
            if not seeds:
                continue
            own = np.array([regrets[variant, problem, s] for s in seeds])
            gaps = np.log(own + _FLOOR) - np.log([regrets[first, problem, s] + _FLOOR for s in seeds])
            error = gaps.std(ddof=1) / math.sqrt(len(seeds)) if len(seeds) > 1 else math.nan
            lines.append(
                f"{problem:16} {variant:14} {len(seeds):3} seeds, median {np.median(own):8.3f}, "
                f"log regret {gaps.mean():+.2f} +- {error:.2f}"
            )
    return lines


def main() -> None:
    """Run what is not on record, and print."""
    options, known = tyro.cli(Defaults, description=__doc__), PROBLEMS | FURTHER
    regrets: dict[tuple[str, str, int], float] = {}
    if options.log.is_file():
        for line in options.log.read_text(encoding="utf-8").splitlines():
            variant, problem, seed, regret = json.loads(line)
            regrets[variant, problem, seed] = regret
    options.log.parent.mkdir(parents=True, exist_ok=True)
    for seed in range(FIRST_SEED, FIRST_SEED + options.seeds):
        for problem in options.problems:
            for variant in options.variants:
                if (variant, problem, seed) in regrets:
                    continue
                regret = regrets[variant, problem, seed] = run(variant, known[problem], seed, options.evaluations)
                with options.log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps([variant, problem, seed, regret]) + "\n")
    print("\n".join(table(regrets, options.variants, options.problems)))


if __name__ == "__main__":
    main()
