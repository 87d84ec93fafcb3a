"""Options that name an environment and a teacher of another package."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from distill.checkpoint import student_kind
from distill.errors import DistillError, InterfaceError
from distill.evaluate import MemoryPolicy
from distill.interfaces import StudentEnv, Teacher, VisionEnv
from distill.policy import StudentPolicy
from distill.providers import load_teacher, make_env
from distill.student import load_student
from distill.vision.policy import VisionPolicy
from distill.vision.student import load_vision_student


@dataclass(frozen=True)
class Provided:
    """Where robots and teacher come from."""

    env: str
    """Environment, by the name of its entry point in group `legged.envs`."""
    teacher: Path
    """Checkpoint of the teacher."""
    option: tuple[str, ...] = ()
    """Options of the environment, as key=value; values are read as JSON where they are."""
    teacher_kind: str | None = None
    """Entry point in group `legged.teachers`; needed if several are installed."""

    def make_env(self) -> StudentEnv:
        """The robots."""
        return make_env(self.env, parse_options(self.option))

    def load_teacher(self) -> Teacher:
        """The teacher."""
        return load_teacher(self.teacher, self.teacher_kind)


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


def with_cameras(env: StudentEnv, name: str) -> VisionEnv:
    """The environment `name`, whose robots must have cameras.

    Raises:
        InterfaceError: they have none.
    """
    if missing := [part for part in ("heading", "depth_shape", "depth_period") if not hasattr(env, part)]:
        raise InterfaceError(
            f"environment '{name}' has no {', '.join(missing)}: a seeing student needs robots with cameras, "
            "such as locorl's 'parkour-depth'"
        )
    return env  # pyright: ignore[reportReturnType]


def student_policy(path: Path, env: StudentEnv, name: str, teacher: Teacher) -> MemoryPolicy:
    """The student in a file, blind or seeing, as a policy for the robots of environment `name`."""
    if student_kind(path) == "blind":
        student = load_student(path, teacher, env.device)
        if student.proprio != (width := env.group_dims["proprio"]):
            raise InterfaceError(f"{path}: reads {student.proprio} columns, environment '{name}' has {width}")
        return StudentPolicy(student, env.num_envs, env.device)
    return VisionPolicy(load_vision_student(path, teacher, env.device), with_cameras(env, name))
