"""Evaluations on a Slurm cluster through submitit."""

from __future__ import annotations

import importlib
import math
import signal
import time
from pathlib import Path
from typing import Any, Literal

from codesign_bo.executors.evaluate import CANCELLED, evaluate
from codesign_bo.executors.slots import SlotExecutor, SlotJob
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult, FailureKind

_POLL = 0.5  # s; submitit itself asks Slurm more rarely
_TAIL = 2000

# What the final states of a job without a result say; any other is the evaluation's own fault.
_KINDS: dict[str, FailureKind] = {
    "TIMEOUT": "timeout",
    "DEADLINE": "timeout",
    "PREEMPTED": "lost",
    "NODE_FAIL": "lost",
    "BOOT_FAIL": "lost",
    "CANCELLED": "lost",
    "REVOKED": "lost",
    "INTERRUPTED": "lost",  # only on cluster "local"
}


class SlurmExecutor(SlotExecutor):
    """Runs each evaluation as a job of a Slurm cluster (extra `[slurm]`).

    Slurm's limits hold, and its verdict tells failures apart. A preempted job is `lost` and not requeued,
    since repeating is for the study to decide. The callback's module, `folder` and the work folders must be
    visible to the whole cluster. The jobs of a coordinator that was killed run on to no purpose: scancel them.

    Args:
        slots: How many jobs are in the cluster at once, those that wait in its queue included.
        folder: Folder for submitit's scripts, pickles and logs (`<job>_0_log.out`, `<job>_0_log.err`).
        timeout_min: Time limit of one evaluation (minutes).
        cluster: `"slurm"`, or `"local"` for processes on this machine, as a rehearsal.
        **parameters: Further ones of submitit: `mem_gb`, `cpus_per_task`, `gpus_per_node`, `slurm_partition`,
            `slurm_account`, `slurm_setup`, ...

    Raises:
        ImportError: submitit is not installed.
        RuntimeError: This is no Slurm cluster.
        NameError: submitit does not know a parameter.

    Example:
        >>> with SlurmExecutor(  # doctest: +SKIP
        ...     slots=8, folder="slurm", timeout_min=240, gpus_per_node=1, mem_gb=32, slurm_partition="gpu"
        ... ) as executor:
        ...     print(executor.submit(evaluate, request).result())
    """

    def __init__(
        self,
        slots: int,
        folder: Path | str,
        timeout_min: int,
        cluster: Literal["slurm", "local"] = "slurm",
        **parameters: Any,
    ) -> None:
        try:
            submitit = importlib.import_module("submitit")
        except ImportError as error:
            raise ImportError("SlurmExecutor needs submitit: pip install 'legged-codesign-bo[slurm]'") from error
        self._submitit = submitit.AutoExecutor(folder, cluster=cluster)
        extra = {"no-requeue": True, **parameters.pop("slurm_additional_parameters", {})}
        self._submitit.update_parameters(timeout_min=timeout_min, slurm_additional_parameters=extra, **parameters)
        super().__init__(slots)

    def _run(self, job: SlotJob, slot: int) -> EvalResult:
        deadline = math.inf if job.request.deadline is None else job.request.deadline
        submitted = self._submitit.submit(_evaluate_in_job, job.callback, job.request)
        ended = False
        try:
            # PREEMPTED is the end, although submitit waits for such a job to be requeued.
            while not (ended := submitted.done() or _state(submitted) == "PREEMPTED"):
                if time.time() > deadline:
                    return EvalResult.failure("timeout", "the deadline passed")
                if job.cancelled.wait(_POLL):
                    return CANCELLED
            return _outcome(submitted)
        finally:
            if not ended:
                submitted.cancel(check=False)


def _evaluate_in_job(callback: Callback, request: EvalRequest) -> str:
    # Leave signals to Slurm: submitit would requeue the job upon one and ignore the other.
    signal.signal(signal.SIGUSR2, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    return evaluate(callback, request)


def _state(submitted: Any) -> str:
    return submitted.state.split()[0]  # as in "CANCELLED by 1000"


def _outcome(submitted: Any) -> EvalResult:
    state = _state(submitted)
    if state == "COMPLETED" or submitted.paths.result_pickle.exists():
        try:
            return EvalResult.from_json(submitted.result())  # waits for a slow file system
        except Exception as error:  # the callback did not load, or ended its process with exit code 0
            return EvalResult.failure("crash", str(error)[-_TAIL:])
    cause = "out of memory: " if state == "OUT_OF_MEMORY" else ""
    stderr = (submitted.stderr() or "")[-_TAIL:].strip()
    message = f"{cause}job {submitted.job_id} ended as {state} without a result\n{stderr}".strip()
    return EvalResult.failure(_KINDS.get(state, "crash"), message)
