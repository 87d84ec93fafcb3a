"""`locorl evaluate`."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import rich
import tyro
from rich.table import Table

from locorl.bodies.designs import design_grid, feasible, sample_designs
from locorl.evaluation.evaluate import EvalConfig, Evaluation, evaluate
from locorl.learning.policy import load_policy
from locorl.providers import find_factory


@dataclass(frozen=True)
class Evaluate:
    """Score a policy on bodies that it may never have seen."""

    checkpoint: Annotated[Path, tyro.conf.Positional]
    robot: str = "go2"
    """An installed robot, or the path of a .urdf."""
    bodies: int = 100
    """Feasible bodies drawn from the design space with --evaluation.seed."""
    grid: int | None = None
    """Instead of random bodies: a regular grid of this many values per parameter (3 gives the paper's 81)."""
    design: tuple[float, ...] | None = None
    """Instead of random bodies: this one."""
    evaluation: EvalConfig = field(default_factory=EvalConfig)
    json: bool = False
    """Print JSON, with every robot's row, instead of a table."""

    def run(self) -> None:
        """Evaluate and print."""
        factory, policy = find_factory(self.robot), load_policy(self.checkpoint)
        policy.check_space(factory.name, factory.space)
        if self.design is not None:
            designs = np.asarray(self.design)[None]
        elif self.grid is not None:
            designs = design_grid(factory, self.grid)
            designs = designs[feasible(factory, designs)]
        else:
            designs = sample_designs(factory, self.bodies, np.random.default_rng(self.evaluation.seed))
        result = evaluate(policy, factory, designs, policy.card.task, self.evaluation)
        if self.json:
            print(json.dumps(to_json(result), indent=1))
        else:
            print_summaries({self.checkpoint.name: result.summary()})


def to_json(result: Evaluation) -> dict[str, object]:
    """Summary, protocol and one row per robot; what is infinite (the cost of going nowhere) becomes None."""
    course = () if result.succeeded is None else ("succeeded",)
    measures = ("returns", "tracking_error", "distance", "energy", "cost_of_transport")
    columns = ("command", "survived", *course, *measures)
    rows = [
        {"design": design.tolist(), **_finite({name: getattr(result, name)[i, j].item() for name in columns})}
        for i, design in enumerate(result.designs)
        for j in range(result.command.shape[1])
    ]
    return {"summary": _finite(result.summary()), "protocol": asdict(result.config), "robots": rows}


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


def print_summaries(results: dict[str, dict[str, float]], title: str = "evaluation") -> None:
    """A table with one column per entry of `results`."""
    table = Table(title=title)
    table.add_column("")
    for name in results:
        table.add_column(name, justify="right")
    for key in next(iter(results.values())):
        table.add_row(key.replace("_", " "), *(f"{summary[key]:.4g}" for summary in results.values()))
    rich.print(table)
