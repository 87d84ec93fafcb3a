"""Tasks: what the robots are asked to do, where, and when an episode ends."""

from locorl.tasks.catalogue import TASKS, Preset, make_task
from locorl.tasks.task import TaskConfig

__all__ = ["TASKS", "Preset", "TaskConfig", "make_task"]
