"""Groups of training runs or of evaluations against each other, at equal samples (section IV-B)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from locorl.config import differences
from locorl.evaluation.evaluate import Evaluation
from locorl.interfaces import Array
from locorl.training.metrics import read_metrics


@dataclass(frozen=True)
class Group:
    """What is compared with other groups: training runs that differ in their seeds, or evaluation files.

    Attributes:
        name: of the group.
        paths: run folders, or files that `locorl evaluate --json` wrote.
    """

    name: str
    paths: tuple[Path, ...]

    @property
    def trained(self) -> bool:
        """Whether these are training runs."""
        return self.paths[0].is_dir()


def read_group(text: str) -> Group:
    """The group that `[name=]path[,path ...]` means.

    A path is a run folder, a folder of run folders, an evaluation's .json, or a pattern of such (`runs/a-*`). The
    default name is the path's own.

    Raises:
        FileNotFoundError: a path leads to neither runs nor evaluations.
        ValueError: runs and evaluations are mixed.
    """
    name, _, places = text.rpartition("=")
    paths = [found for place in places.split(",") for found in _find(place)]
    if len({path.is_dir() for path in paths}) > 1:
        raise ValueError(f"{text}: a group holds training runs or evaluations, not both")
    return Group(name or Path(places.split(",")[0].rstrip("/")).name, tuple(paths))


def _find(place: str) -> list[Path]:
    """Run folders or evaluation files at `place`."""
    path = Path(place)
    there = [path]
    if any(mark in place for mark in "*?["):
        anchor = Path(path.anchor)
        there = sorted(anchor.glob(str(path.relative_to(anchor)))) if path.is_absolute() else sorted(Path().glob(place))
    found: list[Path] = []
    for each in there:
        if (each / "metrics.jsonl").is_file() or (each.is_file() and each.suffix == ".json"):
            found.append(each)
        elif each.is_dir():
            found += sorted(file.parent for file in each.glob("*/metrics.jsonl"))
    runs = [each for each in found if each.is_dir()]
    if not found:
        raise FileNotFoundError(
            f"{place}: neither a run folder (with metrics.jsonl), nor a folder of such, nor an evaluation's .json"
        )
    return runs or found  # a pattern may match an evaluation beside its run


@dataclass(frozen=True)
class Curve:
    """One metric of one run: (k,) environment steps and (k,) values."""

    samples: Array
    values: Array

    def until(self, samples: float) -> Curve:
        """What the run had learned by `samples` environment steps."""
        early = self.samples <= samples
        return Curve(self.samples[early], self.values[early])


def read_curve(run: Path, metric: str) -> Curve:
    """A metric from a run's metrics.jsonl.

    Raises:
        ValueError: the run has no rows yet, or no such metric; the message lists those that it has.
    """
    rows = read_metrics(run / "metrics.jsonl")
    if not rows:
        raise ValueError(f"{run}/metrics.jsonl is empty: the run has not finished an iteration")
    if metric not in rows[-1]:
        known = ", ".join(name for name in rows[-1] if name not in ("iteration", "samples"))
        raise ValueError(f"{run} has no metric '{metric}'; it has: {known}")
    rows = [row for row in rows if metric in row]
    return Curve(*(np.array([row[name] for row in rows], dtype=np.float64) for name in ("samples", metric)))


def common_samples(curves: Sequence[Sequence[Curve]]) -> float:
    """Environment steps that every run of every group has taken."""
    return min(float(curve.samples[-1]) for group in curves for curve in group)


def final_values(curves: Sequence[Curve], samples: float, last: int) -> Array:
    """Of each run, the mean over the last `last` rows until `samples` environment steps, (n,).

    Raises:
        ValueError: `last` is not at least 1, or a run has no row that early.
    """
    if last < 1:
        raise ValueError(f"the mean is over at least 1 iteration, got {last}")
    cut = [curve.until(samples) for curve in curves]
    if not all(len(curve.samples) for curve in cut):
        raise ValueError(f"a run has no iteration within the {samples:g} environment steps that all have in common")
    return np.array([curve.values[-last:].mean() for curve in cut])


def mean_curve(curves: Sequence[Curve], samples: float, points: int = 400) -> tuple[Array, Array, Array]:
    """Mean and standard deviation over runs until `samples`: environment steps, mean, deviation, (points,) each.

    Runs are interpolated between their iterations; a single run has a deviation of 0.
    """
    start = max(float(curve.samples[0]) for curve in curves)
    grid = np.linspace(start, samples, points)
    values = np.stack([np.interp(grid, curve.samples, curve.values) for curve in curves])
    return grid, values.mean(axis=0), values.std(axis=0, ddof=1) if len(curves) > 1 else np.zeros(points)


@dataclass(frozen=True)
class Scores:
    """A measure of the same bodies under one policy, as `locorl evaluate --json` wrote it.

    Attributes:
        values: mean over the robots of each body, (B,).
        designs: (B, d).
        protocol: of the evaluation.
        samples: environment steps that the policy was trained on; None if the file does not tell.
    """

    values: Array
    designs: Array
    protocol: dict[str, object]
    samples: int | None = None

    def __post_init__(self) -> None:
        """Refuse measures that some robots do not have, such as the cost of transport of one that got nowhere."""
        lacking = int((~np.isfinite(self.values)).sum())
        if lacking:
            raise ValueError(f"on {lacking} of {len(self.values)} bodies the measure is not finite; compare returns")


def read_scores(path: Path, measure: str) -> Scores:
    """An evaluation file.

    Raises:
        ValueError: it is no evaluation, has no such measure, or one that is not finite everywhere.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        rows, protocol = content["robots"], content["protocol"]
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ValueError(f"{path} was not written by `locorl evaluate --json`: {error!r}") from error
    if measure not in rows[0]:
        raise ValueError(f"{path} has no measure '{measure}'; it has: {', '.join(rows[0])}")
    each = int(protocol["robots_per_body"])
    values = np.array([row[measure] for row in rows], dtype=np.float64).reshape(-1, each)
    designs = np.array([row["design"] for row in rows[::each]], dtype=np.float64)
    return Scores(values.mean(axis=1), designs, protocol, content.get("samples"))


def scores_of(result: Evaluation, measure: str, samples: int, protocol: dict[str, object]) -> Scores:
    """A fresh evaluation in the same form.

    Raises:
        ValueError: there is no such measure, or it is not finite everywhere.
    """
    values = getattr(result, measure, None)
    if not isinstance(values, np.ndarray) or values.shape != result.command.shape:
        raise ValueError(f"an evaluation has no measure '{measure}'; take returns, tracking_error, distance or energy")
    return Scores(values.astype(np.float64).mean(axis=1), result.designs, protocol, samples)


def check_common(scores: Sequence[Scores]) -> None:
    """Refuse evaluations that do not share bodies, commands and starts.

    Raises:
        ValueError: naming the differences in protocol, or the bodies.
    """
    first = scores[0]
    for other in scores[1:]:
        changes = differences(first.protocol, other.protocol)
        if changes:
            raise ValueError("the evaluations follow different protocols:\n  " + "\n  ".join(changes))
        if not np.array_equal(first.designs, other.designs):
            raise ValueError("the evaluations are of different bodies; evaluate both with the same --evaluation.seed")
