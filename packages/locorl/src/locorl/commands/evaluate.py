"""`locorl evaluate`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import rich
import tyro
from rich.table import Table

from locorl.bodies.designs import design_grid, feasible, sample_designs
from locorl.evaluation.evaluate import EvalConfig, Evaluation, evaluate
from locorl.evaluation.obstacles import success_by_obstacle
from locorl.learning.policy import load_policy
from locorl.play.errors import missing_extra
from locorl.providers import find_factory
from locorl.simulation.make import SimulatorConfig

_UNITS = {
    "distance": "m",
    "commanded_distance": "m",
    "speed": "m/s",
    "commanded_speed": "m/s",
    "tracking_error": "m/s",
    "tracking_error_worst_decile": "m/s",
    "tracking_error_worst": "m/s",
    "energy": "J",
    "foot_clearance": "m",
    "slip": "per metre",
}


@dataclass(frozen=True)
class Evaluate:
    """Score a policy on bodies that it may never have seen."""

    checkpoint: Annotated[Path, tyro.conf.Positional]
    """A policy.pt or checkpoint.pt."""
    robot: str = "go2"
    """An installed robot, or the path of a .urdf."""
    adopt: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Take the policy on even if it was trained on bodies with other rules or gains."""
    bodies: int = 100
    """Feasible bodies drawn from the design space with --evaluation.seed."""
    grid: int | None = None
    """Instead of random bodies: a regular grid of this many values per parameter (3 gives the paper's 81)."""
    design: tuple[float, ...] | None = None
    """Instead of random bodies: this one."""
    evaluation: EvalConfig = field(default_factory=EvalConfig)
    simulator: SimulatorConfig = field(default_factory=SimulatorConfig)
    worst: int = 5
    """Bodies to list with their design: first those that failed, then those that track worst."""
    json: bool = False
    """Print JSON, with every robot's row, instead of tables."""
    plot: Path | None = None
    """Picture (.png) of the tracking error and the failures over the design space; on a course, of success by
    obstacle size too."""

    def run(self) -> None:
        """Evaluate and print."""
        factory, policy = find_factory(self.robot), load_policy(self.checkpoint)
        policy = policy.adopted(factory) if self.adopt else policy
        policy.check_bodies(factory)
        check_plot(self.plot)
        if self.design is not None:
            designs = np.asarray(self.design)[None]
        elif self.grid is not None:
            designs = design_grid(factory, self.grid)
            designs = designs[feasible(factory, designs)]
        else:
            designs = sample_designs(factory, self.bodies, np.random.default_rng(self.evaluation.seed))
        result = evaluate(policy, factory, designs, policy.card.task, self.evaluation, simulator=self.simulator)
        names = factory.space.names
        if self.json:
            print(json.dumps({"samples": policy.card.samples, **to_json(result)}, indent=1))
        else:
            print_summaries({self.checkpoint.name: result.summary()})
            if len(designs) > 1 and self.worst > 0:
                rich.print(worst_table(result, names, self.worst))
            if result.course is not None:
                rich.print(obstacle_table(result))
                for note in course_notes(result):
                    rich.print(f"[yellow]note:[/yellow] {note}")
        if self.plot is not None:
            from locorl.evaluation.plots import bodies_figure, save

            save(bodies_figure(result, names), self.plot)
            if not self.json:
                rich.print(f"bodies -> {self.plot}")


def check_plot(path: Path | None) -> None:
    """Refuse a picture that cannot be drawn before minutes of simulation.

    Raises:
        PlayError: matplotlib is missing.
        ValueError: `path` does not end in .png.
        FileNotFoundError: its folder does not exist.
    """
    if path is None:
        return
    try:
        from locorl.evaluation.plots import check_path
    except ModuleNotFoundError as error:
        raise missing_extra(error) from error
    check_path(path)


def to_json(result: Evaluation) -> dict[str, object]:
    """Summary, protocol and one row per robot; what is infinite (the cost of going nowhere) becomes None."""
    names = ("command", "survived", "returns", "tracking_error", "distance", "energy", "cost_of_transport")
    columns = {name: getattr(result, name) for name in names}
    if result.gait is not None:
        columns |= {"foot_clearance": result.gait.clearance, "slip": result.gait.slip}
        columns["duty_factor"] = result.gait.duty_factor
    if result.course is not None:
        columns |= {"succeeded": result.succeeded, **vars(result.course)}
    rows = [
        {"design": design.tolist(), **_finite({name: values[i, j].item() for name, values in columns.items()})}
        for i, design in enumerate(result.designs)
        for j in range(result.command.shape[1])
    ]
    return {"summary": _finite(result.summary()), "protocol": asdict(result.config), "robots": rows}


def _finite(values: Mapping[str, float | str]) -> dict[str, float | str | None]:
    return {name: value if isinstance(value, str) or math.isfinite(value) else None for name, value in values.items()}


def print_summaries(results: dict[str, dict[str, float]], title: str = "evaluation") -> None:
    """A table with one column per entry of `results`."""
    table = Table(title=title)
    table.add_column("")
    for name in results:
        table.add_column(name, justify="right")
    for key in next(iter(results.values())):
        label = key.replace("_", " ") + (f", {_UNITS[key]}" if key in _UNITS else "")
        table.add_row(label, *(f"{summary[key]:.4g}" for summary in results.values()))
    rich.print(table)


def worst_table(result: Evaluation, names: tuple[str, ...], count: int) -> Table:
    """The `count` worst bodies with their design: first by failures, then by tracking error."""
    course = result.succeeded is not None
    failures = (~result.through).sum(axis=1)
    error = result.tracking_error.mean(axis=1)
    order = np.lexsort((-error, -failures))[:count]
    robots = result.command.shape[1]
    failed = int((failures > 0).sum())
    what = "did not get through" if course else "fell"
    of_them = f"on {failed} of {len(error)} a robot {what}" if robots > 1 else f"{failed} of {len(error)} {what}"
    table = Table(title=f"worst bodies; {of_them}")
    for name in names:
        table.add_column(name.replace("_", " "), justify="right")
    for column in ("survived", *(("succeeded",) if course else ()), "tracking error, m/s", "way of commanded"):
        table.add_column(column, justify="right")
    for body in order:
        cells = [f"{value:.3f}" for value in result.designs[body]]
        cells.append(f"{result.survived[body].sum()} of {robots}")
        if result.succeeded is not None:
            cells.append(f"{result.succeeded[body].sum()} of {robots}")
        share = result.distance[body].sum() / result.commanded_distance[body].sum()
        table.add_row(*cells, f"{error[body]:.3f}", f"{share:.0%}")
    return table


def obstacle_table(result: Evaluation) -> Table:
    """Success on a course by obstacle size in hip heights of each robot's own body."""
    table = Table(title="success by obstacle size")
    table.add_column("course")
    for column in ("hip heights", "robots", "succeeded", "95 % interval"):
        table.add_column(column, justify="right")
    for each in success_by_obstacle(result):
        low, high = each.interval
        size = f"{each.low:.2f} to {each.high:.2f}"
        table.add_row(
            each.kind.replace("_", " "), size, str(each.robots), f"{each.rate:.0%}", f"{low:.0%} to {high:.0%}"
        )
    return table


def course_notes(result: Evaluation) -> list[str]:
    """What success on a course may owe to the protocol: too little time at the commanded speed, a single level."""
    assert result.course is not None
    config, needed = result.config, result.course.length / result.command
    late = int((needed > config.seconds).sum())
    notes = []
    if late:
        notes.append(
            f"{late} of {needed.size} robots had no time to get through at their commanded speed: take "
            f"--evaluation.seconds {math.ceil(1.2 * needed.max())}, or a higher --evaluation.vx"
        )
    if config.level is None and config.robots_per_body == 1:
        notes.append(
            "every body met one course of the middle level: --evaluation.robots-per-body 10 spreads over the levels"
        )
    return notes
