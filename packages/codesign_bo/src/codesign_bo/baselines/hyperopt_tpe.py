"""Hyperopt's tree of Parzen estimators as `fmin(algo=tpe.suggest)` runs it, the paper's outer loop."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from codesign_bo.baselines.base import Baseline, load
from codesign_bo.space import Array, BoxSpace


class HyperoptTPE(Baseline[dict[str, Any]]):
    """`hyperopt.tpe.suggest` with its defaults: the first 20 designs are random, then 24 candidates a suggestion.

    Asked and told in turns it is `fmin(rstate=numpy.random.default_rng(seed))` over the unit cube, to the
    bit. Failures are `STATUS_FAIL`; Hyperopt counts these, and designs that are out, as the worst.
    """

    def __init__(self, space: BoxSpace, seed: int, maximize: bool = True) -> None:
        super().__init__(space, seed, maximize)
        self._hyperopt = load("hyperopt", "hyperopt")
        base, hp = load("hyperopt.base", "hyperopt"), self._hyperopt.hp
        self._labels = tuple(f"x{i}" for i in range(space.dim))
        # the function is never called: the study's user evaluates
        self._domain = base.Domain(lambda design: None, {name: hp.uniform(name, 0.0, 1.0) for name in self._labels})
        self._running, self._done = base.JOB_STATE_RUNNING, base.JOB_STATE_DONE
        self._trials = self._hyperopt.Trials()
        self._rng = np.random.default_rng(seed)

    def _suggest(self) -> tuple[Array, dict[str, Any]]:
        numbers = self._trials.new_trial_ids(1)
        self._trials.refresh()
        draw = self._rng.integers(2**31 - 1)
        made = self._hyperopt.tpe.suggest(numbers, self._domain, self._trials, draw, verbose=False)
        self._trials.insert_trial_docs(made)
        self._trials.refresh()
        trial = self._trials.trials[-1]
        trial["state"] = self._running
        return np.array([trial["misc"]["vals"][name][0] for name in self._labels]), trial

    def _observe(self, handle: dict[str, Any], loss: float) -> None:
        failed = math.isnan(loss)
        ok, fail = self._hyperopt.STATUS_OK, self._hyperopt.STATUS_FAIL
        handle["result"] = {"status": fail} if failed else {"status": ok, "loss": float(loss)}
        handle["state"] = self._done
        self._trials.refresh()
