"""Optuna's tree of Parzen estimators and its Gaussian process, through Optuna's own ask and tell."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from codesign_bo.baselines.base import Baseline, load
from codesign_bo.space import Array, BoxSpace

if TYPE_CHECKING:
    from optuna.samplers import BaseSampler
    from optuna.trial import Trial


class _OptunaStudy(Baseline["Trial"]):
    """A study of Optuna in memory. Asked and told in turns it is `study.optimize`, to the bit.

    A failure is told as the worst loss so far: Optuna's samplers pass over failed trials, and so ask for
    much the same designs again and again.
    """

    def __init__(self, space: BoxSpace, seed: int, maximize: bool = True) -> None:
        super().__init__(space, seed, maximize)
        optuna: Any = load("optuna", "optuna")
        self._failed = optuna.trial.TrialState.FAIL
        self._cube = {f"x{i}": optuna.distributions.FloatDistribution(0.0, 1.0) for i in range(space.dim)}
        self._worst = -math.inf
        self._study = optuna.create_study(sampler=self._sampler(optuna.samplers, seed))

    @abstractmethod
    def _sampler(self, samplers: Any, seed: int) -> BaseSampler:
        """Return the sampler, given the module `optuna.samplers`."""

    def _suggest(self) -> tuple[Array, Trial]:
        trial = self._study.ask(self._cube)
        return np.array([trial.params[name] for name in self._cube]), trial

    def _observe(self, handle: Trial, loss: float) -> None:
        if not math.isnan(loss):
            self._worst = max(self._worst, loss)
        if math.isinf(self._worst):
            self._study.tell(handle, state=self._failed)
        else:
            self._study.tell(handle, float(self._worst if math.isnan(loss) else loss))


class OptunaTPE(_OptunaStudy):
    """`optuna.samplers.TPESampler` with its defaults: the first 10 designs are random."""

    def _sampler(self, samplers: Any, seed: int) -> BaseSampler:
        return samplers.TPESampler(seed=seed)


class OptunaGP(_OptunaStudy):
    """`optuna.samplers.GPSampler` with its defaults: the first 10 designs are random.

    It infers the noise. Its recommendation is Optuna's, `study.best_params`: the best observed design.
    """

    def _sampler(self, samplers: Any, seed: int) -> BaseSampler:
        return samplers.GPSampler(seed=seed)
