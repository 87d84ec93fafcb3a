"""Where evaluations run: processes on this machine, any pool, a Ray cluster, a Slurm cluster."""

from codesign_bo.executors.futures import FuturesExecutor
from codesign_bo.executors.interfaces import Executor, Job
from codesign_bo.executors.local import LocalExecutor
from codesign_bo.executors.ray import RayExecutor
from codesign_bo.executors.slurm import SlurmExecutor

__all__ = ["Executor", "FuturesExecutor", "Job", "LocalExecutor", "RayExecutor", "SlurmExecutor"]
