"""What the runs of `benchmarks/bo.py` say: medians, intervals, comparisons by seed, and the bars to be met."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.bo_runs import Job, Trace

Array = NDArray[np.float64]

OURS, PAPER, PEER = "codesign-bo", "hyperopt-tpe", "optuna-gp"
"""The method under test, the tool of the paper, and the peer that it is held against."""

LEVEL = 0.9
_DRAWS = 10_000


@dataclass(frozen=True)
class Interval:
    """A figure and its 90 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3g} [{self.low:.3g}, {self.high:.3g}]"


@dataclass(frozen=True)
class Row:
    """A method on a problem, over n seeds.

    Attributes:
        method: Name of the method.
        problem: Name of the problem.
        median: Median regret of the last recommendation.
        quartiles: Its 25 % and 75 % quantiles.
        visited: Median over seeds of the lowest regret among the evaluated designs, recommended or not.
        beats_paper: Share of seeds with less regret than Hyperopt; equal regret counts a half.
        to_peer: Median over seeds of the regret less that of Optuna's GPSampler, None where either is missing.
        seconds: Median processor time (s) that the method takes for an evaluation.
    """

    method: str
    problem: str
    median: Interval
    quartiles: tuple[float, float]
    visited: float
    beats_paper: float | None
    to_peer: Interval | None
    seconds: float


@dataclass(frozen=True)
class Bar:
    """Something that was asked for.

    Attributes:
        text: What was asked.
        measured: What came out.
        met: Whether it is met.
    """

    text: str
    measured: str
    met: bool


def _resamples(n: int) -> NDArray[np.int64]:
    return np.random.default_rng(0).integers(n, size=(_DRAWS, n))


def median_interval(values: Array) -> Interval:
    """Median of `values` (n,) with its percentile bootstrap interval."""
    low, high = np.quantile(np.median(values[_resamples(len(values))], axis=1), ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return Interval(float(np.median(values)), float(low), float(high))


def ratio_interval(tops: Sequence[Array], bottoms: Sequence[Array]) -> Interval:
    """Geometric mean over problems of median(top) / median(bottom), with its percentile bootstrap interval.

    Args:
        tops: For each problem, values (n,) by seed.
        bottoms: The same, of the same seeds; seeds are drawn together for both.
    """

    def ratio(seeds: NDArray[np.int64]) -> Array:
        pairs = zip(tops, bottoms, strict=True)
        logs = [np.log(np.median(a[seeds], -1)) - np.log(np.median(b[seeds], -1)) for a, b in pairs]
        return np.exp(np.mean(logs, axis=0))

    n = len(tops[0])
    low, high = np.quantile(ratio(_resamples(n)), ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return Interval(float(ratio(np.arange(n))), float(low), float(high))


class Results:
    """All traces, looked at by method, problem and number of workers.

    Args:
        traces: Of all jobs; each method and problem has the same seeds.
    """

    def __init__(self, traces: Mapping[Job, Trace]) -> None:
        self.traces = dict(sorted(traces.items(), key=lambda item: item[0].seed))
        self.seeds = sorted({job.seed for job in traces})
        self.methods = list(dict.fromkeys(job.method for job in traces))
        self.problems = list(dict.fromkeys(job.problem for job in traces))
        self.workers = sorted({job.workers for job in traces})

    def of(self, method: str, problem: str, workers: int = 1) -> list[Trace]:
        """Traces by seed; none if this was not run."""
        asked = (method, problem, workers)
        return [t for job, t in self.traces.items() if (job.method, job.problem, job.workers) == asked]

    def regret(self, method: str, problem: str, workers: int = 1) -> Array:
        """Regret of the last recommendation, by seed (n,); empty if this was not run."""
        return np.array([trace.regret[-1] for trace in self.of(method, problem, workers)])

    def curve(self, method: str, problem: str) -> Array:
        """Quartiles of the regret after each evaluation, (3, evaluations); not finite where too few have one."""
        regret = np.array([trace.regret for trace in self.of(method, problem)])
        with np.errstate(invalid="ignore"):
            return np.quantile(regret, (0.25, 0.5, 0.75), axis=0)

    def row(self, method: str, problem: str) -> Row:
        """The row of the table."""
        regret = self.regret(method, problem)
        paper, peer = (self.regret(other, problem) if method != other else np.array([]) for other in (PAPER, PEER))
        traces = self.of(method, problem)
        return Row(
            method,
            problem,
            median_interval(regret),
            (float(np.quantile(regret, 0.25)), float(np.quantile(regret, 0.75))),
            float(np.median([min(trace.visited) for trace in traces])),
            float(np.mean((regret < paper) + 0.5 * (regret == paper))) if len(paper) else None,
            median_interval(regret - peer) if len(peer) else None,
            float(np.median([trace.seconds for trace in traces])),
        )

    def rows(self) -> list[Row]:
        """The table, by problem."""
        return [self.row(m, p) for p in self.problems for m in self.methods if self.of(m, p)]

    def slowdown(self, method: str, workers: int) -> dict[str, Interval]:
        """Regret with `workers` relative to one at a time, by problem, and of all of them under `all`."""
        pairs = {p: (self.regret(method, p, workers), self.regret(method, p)) for p in self.problems}
        pairs = {p: pair for p, pair in pairs.items() if all(map(len, pair))}
        ratios = {p: ratio_interval([top], [bottom]) for p, (top, bottom) in pairs.items()}
        return ratios | ({"all": ratio_interval(*zip(*pairs.values(), strict=True))} if pairs else {})


def bars(results: Results, suggestion: Mapping[str, float]) -> list[Bar]:
    """What was asked of codesign-bo, as far as it was measured.

    Args:
        results: Of the runs.
        suggestion: Seconds of a suggestion at 100 trials on one core, by problem.
    """
    found: list[Bar] = []
    for problem, bar, aim in (("noisy-hartmann4", 0.30, 0.20), ("ackley4", 4.0, 3.0)):
        if results.of(OURS, problem):
            row = results.row(OURS, problem)
            reached = ", aim reached" if row.median.value <= aim else ""
            text = f"{problem}: median regret at most {bar} (aim {aim})"
            found.append(Bar(text, f"{row.median}{reached}", row.median.value <= bar))
            if problem == "noisy-hartmann4" and row.beats_paper is not None:
                text = f"{problem}: better than {PAPER} on at least 80 % of seeds"
                found.append(Bar(text, f"{row.beats_paper:.0%}", row.beats_paper >= 0.8))
    against = {p: results.row(OURS, p).to_peer for p in ("hartmann6", "levy4", "legs4") if results.of(OURS, p)}
    intervals = {p: interval for p, interval in against.items() if interval is not None}
    if len(intervals) == 3:
        worse = [p for p, i in intervals.items() if i.low > 0]
        better = [p for p, i in intervals.items() if i.high < 0]
        names = ", ".join(intervals)
        found.append(Bar(f"{names}: wholly above {PEER} on none", ", ".join(worse) or "none", not worse))
        found.append(Bar(f"{names}: wholly below {PEER} on at least two", ", ".join(better) or "none", len(better) > 1))
    for workers in results.workers:
        ratios = results.slowdown(OURS, workers) if workers > 1 else {}
        if "all" in ratios:
            text = f"{workers} workers: regret at equal evaluations within 15 % of sequential, over all problems"
            found.append(Bar(text, f"{ratios['all']} times", ratios["all"].value <= 1.15))
    for problem, seconds in suggestion.items():
        text = f"{problem}: a suggestion at 100 trials within 2 s on one core"
        found.append(Bar(text, f"{seconds:.2f} s", seconds <= 2.0))
    return found


def number(value: float | None, digits: int = 3) -> str:
    """A figure for the table."""
    return "-" if value is None or math.isnan(value) else f"{value:.{digits}g}"
