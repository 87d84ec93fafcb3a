"""The command `distill`."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from distill.errors import DistillError
from distill.evaluate import Score, evaluate
from distill.inspection import print_bundle
from distill.policy import StudentPolicy
from distill.providers import load_teacher, make_env
from distill.student import StudentConfig
from distill.train import TrainConfig, train
from distill.verify import verify_bundle


@dataclass(frozen=True)
class Train:
    """Train a student of a privileged teacher, or go on where the run folder stopped."""

    env: str
    """Environment, by the name of its entry point in group `legged.envs`."""
    teacher: Path
    """Checkpoint of the teacher."""
    out: Path
    """Run folder: checkpoint.pt, student.pt, metrics.jsonl."""
    option: tuple[str, ...] = ()
    """Options of the environment, as key=value; values are read as JSON where they are."""
    teacher_kind: str | None = None
    """Entry point in group `legged.teachers`; needed if several are installed."""
    resume: bool = True
    """Go on from the checkpoint in the run folder."""
    eval_steps: int = 500
    """Horizon of the closing comparison of student and teacher, in control steps; 0: none."""
    train: TrainConfig = field(default_factory=TrainConfig)
    """Imitation."""
    student: StudentConfig = field(default_factory=StudentConfig)
    """Architecture."""

    def run(self, console: Console) -> None:
        """Train, then compare student and teacher on the same fresh episodes."""
        env = make_env(self.env, parse_options(self.option))
        teacher = load_teacher(self.teacher, self.teacher_kind)
        student = train(env, teacher, self.out, self.train, self.student, resume=self.resume)
        console.print(f"student: {self.out / 'student.pt'}")
        if self.eval_steps:
            seed = self.train.seed + 1
            policy = StudentPolicy(student, env.num_envs, env.device)
            student_score = evaluate(env, policy, self.eval_steps, seed)
            teacher_score = evaluate(env, teacher, self.eval_steps, seed)
            console.print(_comparison({"teacher": teacher_score, "student": student_score}))


@dataclass(frozen=True)
class Verify:
    """Check a bundle: schema, hashes, and both networks against the golden trace."""

    bundle: Annotated[Path, tyro.conf.Positional]
    """Folder of the bundle."""

    def run(self, console: Console) -> None:
        """Print what was checked."""
        found = verify_bundle(self.bundle)
        console.print(f"{self.bundle}: schema and {found.files} hashes are right")
        for name, error in found.errors.items():
            console.print(f"  {name}: within {error:.1e} of the golden trace over {found.ticks} ticks")


@dataclass(frozen=True)
class Inspect:
    """Explain a bundle: what robot it is for, what it needs, what it is told and what it gives."""

    bundle: Annotated[Path, tyro.conf.Positional]
    """Folder of the bundle."""

    def run(self, console: Console) -> None:
        """Check it and print what it is."""
        print_bundle(self.bundle, console)


def parse_options(options: tuple[str, ...]) -> dict[str, object]:
    """Read key=value pairs; a value that is JSON is read as JSON, any other as text.

    Raises:
        DistillError: an option has no "=".
    """
    table: dict[str, object] = {}
    for option in options:
        key, equals, value = option.partition("=")
        if not equals or not key:
            raise DistillError(f"option '{option}' is not of the form key=value")
        try:
            table[key] = json.loads(value)
        except ValueError:
            table[key] = value
    return table


def _comparison(scores: dict[str, Score]) -> Table:
    table = Table("policy", "return", "survival", "velocity estimate error (m/s)")
    for name, score in scores.items():
        error = "" if score.velocity_error is None else f"{score.velocity_error:.3f}"
        table.add_row(name, f"{score.returns.mean():.3f}", f"{100 * score.survived.float().mean():.1f} %", error)
    return table


def main() -> None:
    """Entry point of the command."""
    command = tyro.extras.subcommand_cli_from_dict(
        {"train": Train, "verify": Verify, "inspect": Inspect}, prog="distill", description=__doc__
    )
    try:
        command.run(Console())
    except (DistillError, OSError) as error:
        print(f"distill: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("distill: stopped; the same command goes on from the last checkpoint", file=sys.stderr)
        sys.exit(130)
