"""`locorl compare`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import rich
import tyro
from rich.table import Table

from locorl.bodies.designs import sample_designs
from locorl.commands.evaluate import check_plot
from locorl.config import differences, to_dict
from locorl.evaluation.compare import (
    Curve,
    Group,
    Scores,
    check_common,
    common_samples,
    final_values,
    read_curve,
    read_group,
    read_scores,
    scores_of,
)
from locorl.evaluation.evaluate import EvalConfig, evaluate
from locorl.evaluation.statistics import welch
from locorl.interfaces import Array
from locorl.learning.policy import Policy, load_policy
from locorl.providers import find_factory
from locorl.tasks.task import TaskConfig


@dataclass(frozen=True)
class Compare:
    """Welch's t-test between groups of training runs, or of evaluations, at equal samples."""

    groups: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Two or more of [name=]path[,path ...]: run folders that differ in their seeds, folders of such, patterns
    ('runs/a-*'), or files of `locorl evaluate --json`. All are compared with the first."""
    metric: str = "reward"
    """Column of metrics.jsonl."""
    last: int = 20
    """Iterations at the end, until the samples that all runs have in common, over which a run's metric is averaged."""
    evaluate: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Instead of the training's metric: evaluate each run's policy.pt on common random numbers."""
    measure: str = "returns"
    """What is compared of evaluations: returns, tracking_error, distance or energy."""
    robot: str = "go2"
    """For --evaluate: an installed robot, or the path of a .urdf."""
    bodies: int = 100
    """For --evaluate: feasible bodies drawn from the design space with --evaluation.seed."""
    evaluation: EvalConfig = field(default_factory=EvalConfig)
    confidence: float = 0.95
    """Of the intervals."""
    plot: Path | None = None
    """Learning curves of --metric with bands, as a .png."""

    def run(self) -> None:
        """Compare and print."""
        groups = [read_group(text) for text in self.groups]
        if len({group.name for group in groups}) < max(2, len(groups)):
            raise ValueError("compare needs two groups or more, with different names: name=path")
        if len({group.trained for group in groups}) > 1:
            raise ValueError("training runs cannot be compared with evaluations; --evaluate evaluates the runs")
        trained = groups[0].trained
        if not trained and (self.evaluate or self.plot):
            raise ValueError("--evaluate and --plot need run folders, not evaluations")
        check_plot(self.plot)
        if trained and not self.evaluate:
            self._compare_training(groups)
        else:
            self._compare_evaluations(groups)
        if self.plot is not None:
            from locorl.evaluation.plots import curves_figure, save

            curves = self._curves(groups)
            save(curves_figure(curves, common_samples(list(curves.values())), self.metric), self.plot)
            rich.print(f"learning curves -> {self.plot}")

    def _curves(self, groups: Sequence[Group]) -> dict[str, list[Curve]]:
        return {group.name: [read_curve(run, self.metric) for run in group.paths] for group in groups}

    def _compare_training(self, groups: Sequence[Group]) -> None:
        curves = self._curves(groups)
        samples = common_samples(list(curves.values()))
        values = {name: final_values(own, samples, self.last) for name, own in curves.items()}
        title = f"{self.metric}, mean of the last {self.last} iterations until {samples / 1e6:.4g} M environment steps"
        rich.print(comparison_table(values, title, "runs", self.confidence))
        if min(len(own) for own in values.values()) < 2:
            rich.print(
                "a t-test needs two runs or more in each group: train with other seeds, or compare bodies with "
                "--evaluate"
            )

    def _compare_evaluations(self, groups: Sequence[Group]) -> None:
        scores = self._evaluate(groups) if self.evaluate else self._read(groups)
        check_common([each for own in scores.values() for each in own])
        alone = all(len(own) == 1 for own in scores.values())
        values = {
            name: own[0].values if alone else np.array([each.values.mean() for each in own])
            for name, own in scores.items()
        }
        unit = "bodies" if alone else "runs"
        rich.print(comparison_table(values, f"{self.measure} on common random numbers", unit, self.confidence))
        if alone:
            rich.print("over bodies: whether these policies differ, not whether other seeds of the same methods would")
        known = {each.samples for own in scores.values() for each in own}
        if len(known) > 1:
            steps = ", ".join(sorted("unknown" if each is None else f"{each / 1e6:.4g} M" for each in known))
            rich.print(f"[yellow]the policies were trained on different numbers of environment steps:[/yellow] {steps}")

    def _read(self, groups: Sequence[Group]) -> dict[str, list[Scores]]:
        return {group.name: [read_scores(path, self.measure) for path in group.paths] for group in groups}

    def _evaluate(self, groups: Sequence[Group]) -> dict[str, list[Scores]]:
        factory, protocol = find_factory(self.robot), to_dict(self.evaluation)
        policies = {group.name: [load_policy(run / "policy.pt") for run in group.paths] for group in groups}
        task = _common_task([policy for own in policies.values() for policy in own])
        designs = sample_designs(factory, self.bodies, np.random.default_rng(self.evaluation.seed))

        def score(policy: Policy) -> Scores:
            policy.check_bodies(factory, "runs on different bodies do not compare; evaluate each on its own")
            result = evaluate(policy, factory, designs, task, self.evaluation)
            return scores_of(result, self.measure, policy.card.samples, protocol)

        return {name: [score(policy) for policy in own] for name, own in policies.items()}


def _common_task(policies: Sequence[Policy]) -> TaskConfig:
    """The task of all policies; returns on different tasks do not compare."""
    task = policies[0].card.task
    for policy in policies[1:]:
        changes = differences(to_dict(task), to_dict(policy.card.task))
        if changes:
            raise ValueError("the runs were trained on different tasks:\n  " + "\n  ".join(changes))
    return task


def comparison_table(values: Mapping[str, Array], title: str, unit: str, confidence: float = 0.95) -> Table:
    """Mean and standard deviation of each group, and its difference from the first; p-values are per comparison."""
    table = Table(title=title)
    interval = f"{confidence:.0%} interval"
    for column in ("group", unit, "mean", "sd", "difference", interval, "p (Welch)"):
        table.add_column(column, justify="left" if column == "group" else "right")
    first, *_ = values.values()
    for number, (name, own) in enumerate(values.items()):
        deviation = f"{own.std(ddof=1):.4g}" if len(own) > 1 else "-"
        row = [name, str(len(own)), f"{own.mean():.5g}", deviation]
        if number and min(len(first), len(own)) > 1:
            test = welch(first, own, confidence)
            row += [f"{test.value:+.4g}", f"{test.low:+.4g} to {test.high:+.4g}", f"{test.p:.3g}"]
        elif number:
            row += [f"{own.mean() - first.mean():+.4g}", "-", "-"]
        table.add_row(*row)
    return table
