"""`distill evaluate`."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from distill.commands.providing import Provided, student_policy
from distill.comparison import print_scores, table_of
from distill.evaluate import MemoryPolicy, evaluate
from distill.film import evaluate_on_film
from distill.interfaces import Teacher, check_teacher


@dataclass(frozen=True)
class Evaluate(Provided):
    """Compare a student, blind or seeing, with its teacher on the same fresh episodes."""

    student: Path = field(kw_only=True)
    """student.pt or checkpoint.pt of its training."""
    steps: int = 1000
    """Longest episode that is judged, control steps."""
    seed: int = 1
    """Of the episodes."""
    video: Path | None = None
    """Film of one robot under teacher and student side by side, as an .mp4 (needs the extra `video`)."""
    robot: int = 0
    """Which robot is filmed."""
    json: Path | None = None
    """The same numbers as a file."""

    def run(self, console: Console) -> None:
        """Print a table of all robots, and one for each thing that they differ in."""
        env, teacher = self.make_env(), self.load_teacher()
        check_teacher(env, teacher)
        policies: dict[str, MemoryPolicy | Teacher] = {
            "teacher": teacher,
            "student": student_policy(self.student, env, self.env, teacher),
        }
        if self.video is None:
            scores = {name: evaluate(env, policy, self.steps, self.seed) for name, policy in policies.items()}
        else:
            scores = evaluate_on_film(env, policies, self.steps, self.seed, self.video, self.robot)
            console.print(f"film: {self.video}", soft_wrap=True)
        print_scores(console, scores)
        if self.json is not None:
            self.json.parent.mkdir(parents=True, exist_ok=True)
            self.json.write_text(json.dumps(table_of(scores), indent=1) + "\n", encoding="utf-8")
