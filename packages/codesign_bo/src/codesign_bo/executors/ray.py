"""Evaluations on a Ray cluster: many machines, or this one with its resources counted."""

from __future__ import annotations

import importlib
import math
import os
import time
from collections.abc import Mapping
from typing import Any

from codesign_bo.executors.evaluate import CANCELLED, PickledCallback
from codesign_bo.executors.local import LocalExecutor
from codesign_bo.executors.ray_cluster import Pulse, check_resources
from codesign_bo.executors.slots import SlotExecutor, SlotJob
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult

_POLL = 0.2  # s
_DEADLINE_GRACE = 10.0  # s for the node to report that a deadline has passed
_END_GRACE = 10.0  # s for a cancelled task to end


class RayExecutor(SlotExecutor):
    """Runs evaluations on a Ray cluster (extra `[ray]`).

    Ray finds a node with the resources; there each evaluation has a fresh process under a `LocalExecutor`,
    with its limits, logs and way of killing. Work folders are those of the node: share them between nodes to
    have the logs in one place. Ray itself never repeats an evaluation.

    If the process is connected to a cluster (`ray.init(...)`), that is used and stays connected; otherwise
    one is found by RAY_ADDRESS or started on this machine, and left or stopped on `close`.

    Args:
        slots: How many evaluations run at once.
        num_cpus: Cores that one evaluation needs.
        num_gpus: GPUs that one evaluation needs.
        memory: Memory (bytes) that one evaluation needs, and the most that it may take; or None.
        runtime_env: Ray's description of what nodes need (`working_dir`, `pip`, `env_vars`, ...).
        timeout: Longest wall-clock time (s) of one evaluation, or None; waiting for resources is not counted.

    Raises:
        ImportError: Ray is not installed.
        ValueError: A setting is out of range.
        ConnectionError: There is no cluster at RAY_ADDRESS.
        ExecutorError: No node that is up has what one evaluation needs.

    Example:
        >>> ray.init("auto")  # doctest: +SKIP
        >>> with RayExecutor(slots=8, num_cpus=4, num_gpus=0.5) as executor:  # doctest: +SKIP
        ...     print(executor.submit(evaluate, request).result())
    """

    def __init__(
        self,
        slots: int,
        num_cpus: float = 1.0,
        num_gpus: float = 0.0,
        memory: int | None = None,
        runtime_env: Mapping[str, Any] | None = None,
        timeout: float | None = None,
    ) -> None:
        try:
            ray = importlib.import_module("ray")
        except ImportError as error:
            raise ImportError("RayExecutor needs Ray: pip install 'legged-codesign-bo[ray]'") from error
        self._ray = ray
        self._own_session = not ray.is_initialized()
        if self._own_session:
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
            ray.init(include_dashboard=False, log_to_driver=False)
        resources = {"num_cpus": num_cpus, "num_gpus": num_gpus, "memory": memory}
        try:
            self._task = ray.remote(_evaluate_on_node).options(
                **resources, runtime_env=dict(runtime_env or {}), max_retries=0
            )
            self._limits = {"timeout": timeout, "memory": memory}
            LocalExecutor(**self._limits).close()  # refuses what a node would refuse
            self._pulse = Pulse(ray)
            asked = {"CPU": num_cpus, "GPU": num_gpus, "memory": memory or 0}
            check_resources(ray.nodes(), {name: each for name, each in asked.items() if each}, self._pulse.address)
            super().__init__(slots)
        except BaseException:
            self._leave()
            raise

    def submit(self, callback: Callback, request: EvalRequest) -> SlotJob:
        """Evaluate `callback(request)` as soon as a slot, and then a node, is free.

        Raises:
            TypeError: The callback cannot be pickled, not even by cloudpickle.
            RuntimeError: The executor is closed.
        """
        return super().submit(PickledCallback(callback, self._ray.cloudpickle.dumps), request)

    def _run(self, job: SlotJob, slot: int) -> EvalResult:
        ray = self._ray
        try:
            return self._evaluated(job)
        except ray.exceptions.OutOfMemoryError as error:
            return EvalResult.failure("crash", f"out of memory: {error}")
        except Exception as error:  # of the node or its worker: the callback dies in a process of its own
            self._pulse.feel(now=True)
            if not isinstance(error, ray.exceptions.RayError):
                raise
            return EvalResult.failure("lost", f"Ray lost the evaluation: {error}")

    def _evaluated(self, job: SlotJob) -> EvalResult:
        ray = self._ray
        deadline = math.inf if job.request.deadline is None else job.request.deadline + _DEADLINE_GRACE
        task = self._task.remote(job.callback, job.request, self._limits)
        while not ray.wait([task], timeout=_POLL)[0]:
            late = time.time() > deadline
            if late or job.cancelled.is_set():
                if not self._pulse.gone:  # who is gone has nothing to end
                    ray.cancel(task, force=True)
                    ray.wait([task], timeout=_END_GRACE)
                return EvalResult.failure("timeout", "the deadline passed") if late else CANCELLED
            self._pulse.feel()
        return EvalResult.from_json(ray.get(task))

    def close(self) -> None:
        """Kill all evaluations that are not done; leave the cluster, if this executor had joined or started it."""
        super().close()
        self._leave()

    def _leave(self) -> None:
        if self._own_session:
            self._own_session = False
            self._ray.shutdown()


def _evaluate_on_node(callback: Callback, request: EvalRequest, limits: Mapping[str, Any]) -> str:
    with LocalExecutor(**limits) as executor:
        return executor.submit(callback, request).result().to_json()
