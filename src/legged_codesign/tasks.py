"""What a run's task stands for: the ground to walk on, and the generalist that a search starts from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from locorl import TaskConfig, make_task

TaskName = Literal["flat", "steps", "hills", "slope", "highjump", "longjump", "stones"]


@dataclass(frozen=True)
class RunTask:
    """A task that bodies are searched for.

    Attributes:
        task: name in `locorl.TASKS`.
        pretraining: task of the generalist, which has seen more kinds of ground than one.
        shipped: the task in the name of the folder of the generalist that ships, such as `flat` in `go2-flat`.
        robot: that the paper takes (section IV-A2).
    """

    task: str
    pretraining: str
    shipped: str
    robot: str

    @property
    def parkour(self) -> bool:
        """Whether it is a course with waypoints."""
        return self.task.startswith("parkour")

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of terrain that bodies are searched for."""
        return make_task(self.task).terrain.kinds


RUN_TASKS: Mapping[TaskName, RunTask] = {
    "flat": RunTask("locomotion-flat", "locomotion-flat", "flat", "go2"),
    "steps": RunTask("locomotion-steps", "locomotion-rough", "rough", "go2"),
    "hills": RunTask("locomotion-hills", "locomotion-rough", "rough", "go2"),
    "slope": RunTask("locomotion-slope", "locomotion-rough", "rough", "go2"),
    "highjump": RunTask("parkour-highjump", "parkour-mixed", "parkour", "lite3"),
    "longjump": RunTask("parkour-longjump", "parkour-mixed", "parkour", "lite3"),
    "stones": RunTask("parkour-stones", "parkour-mixed", "parkour", "lite3"),
}
"""The tasks by name: section IV-A2, slopes from section IV-C, stones from the released code of the authors."""


def pretraining_task(name: TaskName, preset: Literal["laptop", "paper"]) -> TaskConfig:
    """The task that a generalist for `name` is trained on: the mixed ground, and the task's own kinds if it lacks them.

    Raises:
        ValueError: there is no such task.
    """
    chosen = find_task(name)
    task = make_task(chosen.pretraining, preset)
    kinds = task.terrain.kinds
    return task.on((*kinds, *(kind for kind in chosen.kinds if kind not in kinds)))


def searched_task(name: TaskName, trained: TaskConfig) -> TaskConfig:
    """The task on which bodies are fine-tuned and scored: that of their generalist on the ground of `name` alone.

    A map that has these kinds already stays as it is.
    """
    chosen = find_task(name)
    if trained.terrain.kinds == chosen.kinds:
        return trained
    return replace(trained.on(chosen.kinds), name=chosen.task)


def find_task(name: str) -> RunTask:
    """The task of that name.

    Raises:
        ValueError: there is none.
    """
    for known, task in RUN_TASKS.items():
        if known == name:
            return task
    raise ValueError(f"there is no task '{name}'; there are {', '.join(RUN_TASKS)}")
