"""`distill evaluate`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.table import Table

from distill.commands.providing import Provided, student_policy
from distill.evaluate import MemoryPolicy, Score, evaluate
from distill.film import evaluate_on_film
from distill.interfaces import Teacher


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


def table_of(scores: Mapping[str, Score]) -> dict[str, object]:
    """Policy -> "all" and each thing that robots differ in -> means, as JSON data."""
    return {
        name: {"all": score.summary(), **{what: score.by(what) for what in score.groups}}
        for name, score in scores.items()
    }


def print_scores(console: Console, scores: Mapping[str, Score]) -> None:
    """Print the means of policies over all robots, then by terrain, body and so on."""
    console.print(_table("all robots", {name: {"": score.summary()} for name, score in scores.items()}))
    first = next(iter(scores.values()))
    for what, groups in first.groups.items():
        if len(set(groups)) > 1:
            console.print(_table(f"by {what}", {name: score.by(what) for name, score in scores.items()}))


_FORMATS = {
    "robots": ("robots", "{:.0f}", 1.0),
    "return": ("return", "{:.3f}", 1.0),
    "tracking_error": ("tracking error, m/s", "{:.3f}", 1.0),
    "succeeded": ("succeeded", "{:.1f} %", 100.0),
    "survived": ("survived", "{:.1f} %", 100.0),
    "velocity_error": ("error of estimated velocity, m/s", "{:.3f}", 1.0),
}


def _table(title: str, rows: Mapping[str, Mapping[str, Mapping[str, float]]]) -> Table:
    """Policy -> group -> means, with the policies of a group below each other."""
    known = {key for groups in rows.values() for means in groups.values() for key in means}
    columns = [key for key in _FORMATS if key in known]
    grouped = any(group for groups in rows.values() for group in groups)
    table = Table(*(("group",) if grouped else ()), "policy", *(_FORMATS[key][0] for key in columns), title=title)
    for group in next(iter(rows.values())):
        for policy, groups in rows.items():
            means = groups[group]
            cells = [_FORMATS[key][1].format(means[key] * _FORMATS[key][2]) if key in means else "" for key in columns]
            table.add_row(*((group,) if grouped else ()), policy, *cells)
    return table
