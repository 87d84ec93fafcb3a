"""`distill export`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from distill.checkpoint import student_kind
from distill.export import export_bundle
from distill.providers import load_teacher
from distill.spec_file import read_spec
from distill.student import load_student
from distill.vision.export import export_vision_bundle
from distill.vision.student import load_vision_student


@dataclass(frozen=True)
class Export:
    """Write a student, blind or seeing, as a bundle that a robot can run."""

    student: Path
    """student.pt or checkpoint.pt of its training."""
    teacher: Path
    """Checkpoint of its teacher, which gives the shape of the backbone."""
    spec: Path
    """What the bundle says of robot and interface, as .json (`codesign student` writes one; see distill.spec_file)."""
    out: Path
    """Folder of the bundle; one that is there stays until the new one is complete."""
    teacher_kind: str | None = None
    """Entry point in group `legged.teachers`; needed if several are installed."""

    def run(self, console: Console) -> None:
        """Write and verify it."""
        spec, teacher = read_spec(self.spec), load_teacher(self.teacher, self.teacher_kind)
        if student_kind(self.student) == "blind":
            export_bundle(self.out, load_student(self.student, teacher), spec)
        else:
            export_vision_bundle(self.out, load_vision_student(self.student, teacher), spec)
        console.print(f"bundle: {self.out}; `distill inspect {self.out}` explains it", soft_wrap=True)
