"""Other optimisers behind one interface, to compare a study with: what they suggest, and what they recommend.

Random search and Sobol points need nothing more; Hyperopt, Optuna and CMA-ES come with the extra
`legged-codesign-bo[baselines]` and are imported only when one of them is made.

Example:
    >>> from codesign_bo import BoxSpace
    >>> optimiser = make_optimiser("sobol", BoxSpace.box(["thigh"], 0.6, 1.4, 1.0), seed=0)
    >>> design = optimiser.ask()
    >>> optimiser.tell(design, mean=1.0, sem=0.1)
    >>> optimiser.recommend() == design
    True
"""

from __future__ import annotations

from codesign_bo.baselines.base import Baseline
from codesign_bo.baselines.cma_es import CMAES
from codesign_bo.baselines.hyperopt_tpe import HyperoptTPE
from codesign_bo.baselines.interfaces import Optimiser, OptimiserFactory, Params
from codesign_bo.baselines.optuna_samplers import OptunaGP, OptunaTPE
from codesign_bo.baselines.spread import RandomSearch, SobolSearch
from codesign_bo.baselines.study_optimiser import StudyOptimiser
from codesign_bo.space import BoxSpace

OPTIMISERS: dict[str, OptimiserFactory] = {
    "codesign-bo": StudyOptimiser,
    "random": RandomSearch,
    "sobol": SobolSearch,
    "hyperopt-tpe": HyperoptTPE,
    "optuna-tpe": OptunaTPE,
    "optuna-gp": OptunaGP,
    "cma-es": CMAES,
}
"""Everything that can be compared, by name."""


def make_optimiser(name: str, space: BoxSpace, seed: int, maximize: bool = True) -> Optimiser:
    """Return a new optimiser.

    Args:
        name: One of `OPTIMISERS`.
        space: What is searched.
        seed: Seed of everything random in it, at least 0.
        maximize: Whether higher means are better.

    Raises:
        ValueError: There is no such optimiser, or the seed is negative.
        ImportError: It needs a library that is not installed; the message says how to install it.
    """
    if name not in OPTIMISERS:
        raise ValueError(f"there is no optimiser {name!r}; choose one of {', '.join(OPTIMISERS)}")
    return OPTIMISERS[name](space, seed, maximize)


__all__ = [
    "CMAES",
    "OPTIMISERS",
    "Baseline",
    "HyperoptTPE",
    "Optimiser",
    "OptimiserFactory",
    "OptunaGP",
    "OptunaTPE",
    "Params",
    "RandomSearch",
    "SobolSearch",
    "StudyOptimiser",
    "make_optimiser",
]
