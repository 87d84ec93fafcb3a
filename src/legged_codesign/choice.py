"""Which body won, by how much, and under which policy."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from codesign_bo import Study
from locorl.interfaces import Array

from legged_codesign.config import Objective
from legged_codesign.objective import physical


@dataclass(frozen=True)
class Choice:
    """The body that a run settles on, compared with the nominal one on fresh seeds that both share.

    Attributes:
        trial: its trial in the search; 0 if no body was better than the nominal one.
        repeat: confirmation run whose policy becomes the teacher: the one with the best score.
        params: its design parameters.
        mean: its mean score over the fresh seeds.
        nominal: mean score of the nominal body.
        gain: relative improvement of the best searched body, a fraction of the nominal score; may be negative.
        low: lower end of its 95 % interval, which holds for all confirmed bodies together.
        high: upper end.
        seeds: number of fresh seeds.
        challenger: trial of the best searched body, which `gain` speaks of.
    """

    trial: int
    repeat: int
    params: Mapping[str, float]
    mean: float
    nominal: float
    gain: float
    low: float
    high: float
    seeds: int
    challenger: int

    @property
    def significant(self) -> bool:
        """Whether the interval of the gain excludes 0."""
        return self.low > 0.0 or self.high < 0.0

    def design(self, names: Sequence[str]) -> Array:
        """The design vector, (d,)."""
        return np.array([self.params[name] for name in names])

    def sentence(self, objective: Objective) -> str:
        """The result in words."""
        body = ", ".join(f"{name.replace('_', ' ')} {value:.2f}" for name, value in self.params.items())
        values = f"{physical(self.mean, objective):.4f} against {physical(self.nominal, objective):.4f}"
        gain = f"{100 * self.gain:+.1f} % (95 % interval {100 * self.low:+.1f} to {100 * self.high:+.1f} %)"
        if self.trial == 0:
            return f"no searched body beat the nominal one on {self.seeds} fresh seeds; the best differed by {gain}"
        verdict = "a real gain" if self.significant else "not separable from the nominal body"
        return f"best body: {body}; {objective} {values}, {gain} on {self.seeds} fresh seeds: {verdict}"

    def to_json(self) -> str:
        """As JSON text."""
        return json.dumps({**asdict(self), "params": dict(self.params)}, indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Choice:
        """From the text that `to_json` wrote."""
        return cls(**json.loads(text))


def choose(study: Study) -> Choice:
    """The confirmed body with the best mean score, the nominal one included.

    Raises:
        RuntimeError: the nominal body or every other one failed its confirmation.
    """
    confirmation = study.confirmation()
    best = confirmation.best
    if best is None:
        raise RuntimeError(
            f"no body could be compared with the nominal one: confirmation runs of trials "
            f"{confirmation.failed} failed; "
            "their messages are in the study (codesign_bo show)"
        )
    trial = best.trial if best.gain > 0.0 else 0
    runs = [r for r in study.confirmations() if r.trial == trial and r.result is not None and r.result.ok]
    teacher = max(runs, key=lambda run: run.result.mean if run.result else float("-inf"))
    gain, low, high = best.relative
    return Choice(
        trial=trial,
        repeat=teacher.repeat,
        params={name: float(value) for name, value in study.trials()[trial].params.items()},
        mean=best.mean if trial else best.nominal_mean,
        nominal=best.nominal_mean,
        gain=gain,
        low=low,
        high=high,
        seeds=best.repeats,
        challenger=best.trial,
    )
