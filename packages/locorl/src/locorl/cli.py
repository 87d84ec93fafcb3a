"""The `locorl` command: train a generalist, fine-tune it to a body, evaluate it honestly."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from locorl.bodies.designs import design_grid, feasible, sample_designs
from locorl.learning.checkpoint import CheckpointError
from locorl.learning.evaluate import EvalConfig, Evaluation, evaluate
from locorl.learning.finetune import FinetuneConfig, finetune
from locorl.learning.policy import load_policy
from locorl.learning.ppo import DivergedError
from locorl.learning.train import TrainConfig, Trainer
from locorl.providers import find_factory

console = Console()


@dataclass(frozen=True)
class Train:
    """Train a generalist on random bodies; a folder with a checkpoint is resumed."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Where checkpoint.pt, policy.pt, metrics.jsonl and config.json go."""
    robot: str = "go2"
    """An installed robot, or the path of a .urdf."""
    start: Path | None = None
    """Policy to go on from, for instance with other reward weights; the optimiser starts fresh."""
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)

    def run(self) -> None:
        """Train."""
        samples = self.config.samples_per_iteration * self.config.iterations
        console.print(
            f"{self.config.num_envs} robots x {self.config.ppo.steps} steps x {self.config.iterations} iterations "
            f"= {samples / 1e6:.1f} M environment steps -> {self.folder}"
        )
        start = None if self.start is None else load_policy(self.start)
        trainer = Trainer(find_factory(self.robot), self.config, self.folder, start=start)
        trainer.run()


@dataclass(frozen=True)
class Finetune:
    """Fine-tune a generalist to one body and print both policies' scores on it."""

    checkpoint: Annotated[Path, tyro.conf.Positional]
    folder: Annotated[Path, tyro.conf.Positional]
    design: tuple[float, ...]
    """Design parameters in the order of the design space."""
    robot: str = "go2"
    """An installed robot, or the path of a .urdf."""
    seed: int = 0
    config: FinetuneConfig = field(default_factory=FinetuneConfig)
    evaluation: EvalConfig = field(default_factory=lambda: EvalConfig(robots_per_body=64, reset_joint=0.1))

    def run(self) -> None:
        """Fine-tune and compare."""
        factory, generalist = find_factory(self.robot), load_policy(self.checkpoint)
        design = np.asarray(self.design)
        tuned = finetune(generalist, factory, design, self.config, self.seed, self.folder, quiet=False)
        tuned.policy.save(self.folder / "policy.pt")
        results = {
            name: evaluate(policy, factory, design[None], generalist.card.task, self.evaluation).summary()
            for name, policy in (("generalist", generalist), ("fine-tuned", tuned.policy))
        }
        print_summaries(results)


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
    columns = ("command", "survived", "returns", "tracking_error", "distance", "energy", "cost_of_transport")
    rows = [
        {"design": design.tolist(), **_finite({name: getattr(result, name)[i, j].item() for name in columns})}
        for i, design in enumerate(result.designs)
        for j in range(result.command.shape[1])
    ]
    return {"summary": _finite(result.summary()), "protocol": asdict(result.config), "robots": rows}


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


def print_summaries(results: dict[str, dict[str, float]]) -> None:
    """A table with one column per policy."""
    table = Table(title="evaluation")
    table.add_column("")
    for name in results:
        table.add_column(name, justify="right")
    for key in next(iter(results.values())):
        table.add_row(key.replace("_", " "), *(f"{summary[key]:.4g}" for summary in results.values()))
    console.print(table)


def main() -> None:
    """Entry point of the `locorl` command."""
    command = tyro.cli(Train | Finetune | Evaluate, description=__doc__)
    try:
        command.run()
    except (CheckpointError, DivergedError, LookupError, ValueError, OSError) as error:
        console.print(f"[red]error:[/red] {escape(str(error))}", highlight=False)
        sys.exit(1)
    except KeyboardInterrupt:
        console.print("\nstopped; the same command goes on from the last checkpoint")
        sys.exit(130)
