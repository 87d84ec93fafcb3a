r"""Put a trained student into the package: its bundle, its teacher, and how both were judged.

    python tools/ship_student.py go2-blind

`STUDENTS` has the command that trains each, to be run first.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from distill import verify_bundle
from locorl import read_metrics

PRETRAINED = Path(__file__).parents[1] / "src" / "legged_codesign" / "pretrained"


@dataclass(frozen=True)
class Student:
    """How a student is trained and judged."""

    command: str
    folder: str
    """Where the command leaves it."""
    options: str
    """Of `distill evaluate`: the environment that it is judged in."""

    def evaluation(self, home: str) -> str:
        """The command that judges it beside its teacher."""
        files = f"--teacher {home}/teacher.pt --student {home}/student.pt"
        return f"distill evaluate {self.options} policy={home}/teacher.pt {files} --video side_by_side.mp4"


STUDENTS: Mapping[str, Student] = {
    "go2-blind": Student(
        "python studies/student_blind.py --seeds 1",
        "runs/studies/student-blind/hills-seed-1",
        """--env locomotion --option robot=go2 'design=[1,1,1,1]' 'terrain=["hills"]' num_envs=100 'vx=[0.5,0.5]' """
        "terrain_seed=4242",
    ),
    "lite3-depth": Student(
        "python studies/student_depth.py --seeds 1",
        "runs/studies/student-depth/seeing-seed-1",
        """--env parkour-depth --option robot=lite3 'design=[1,1,1,1]' 'terrain=["hurdles"]' num_envs=200 """
        "'vx=[0.9,1.0]' terrain_seed=4242",
    ),
}
"""The students that ship, <robot>-<eyes>."""


@dataclass(frozen=True)
class Ship:
    """Options."""

    name: Annotated[str, tyro.conf.Positional]
    """One of `STUDENTS`; the folder to write under pretrained/."""
    folder: Path | None = None
    """Where the student is, if not where its command leaves it."""


def main() -> None:
    """Verify, copy, record."""
    options = tyro.cli(Ship, description=__doc__)
    student, target = STUDENTS[options.name], PRETRAINED / options.name
    folder = options.folder or Path(student.folder)
    verify_bundle(folder / "bundle")
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(folder / "bundle", target / "bundle")
    for path in (folder / "teacher.pt", folder / "student" / "student.pt"):
        shutil.copy(path, target)
    manifest = json.loads((target / "bundle" / "manifest.json").read_text(encoding="utf-8"))
    rows = read_metrics(folder / "student" / "metrics.jsonl")
    record = {
        "command": student.command,
        "minutes": round(sum(row["seconds"] for row in rows) / 60, 1),
        "samples": int(rows[-1]["samples"]),
        "evaluation": {
            "command": student.evaluation(target.relative_to(PRETRAINED.parents[2]).as_posix()),
            "comparison": manifest["training"]["comparison"],
        },
        "machine": manifest["training"]["provenance"],
    }
    (target / "provenance.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(record["evaluation"], indent=1))


if __name__ == "__main__":
    main()
