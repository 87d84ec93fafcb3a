"""What every executor must do: a test class to subclass with a fixture that makes yours."""
# ruff: noqa: D102 (the names of the tests say it)

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from codesign_bo.executors.interfaces import Executor, Job
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult
from codesign_bo.testing import callbacks


class ExecutorContract:
    """Tests of an executor with two slots.

    Attributes:
        isolated: Whether each evaluation has a process that may die, be killed on `cancel` and `close`, and is
            killed when `request.deadline` passes. A thread pool is not.

    Example:
        >>> class TestMyExecutor(ExecutorContract):
        ...     @pytest.fixture
        ...     def executor(self):
        ...         with MyExecutor(slots=2) as executor:
        ...             yield executor
    """

    isolated = True

    @pytest.fixture
    def executor(self) -> Iterator[Executor]:
        """Give an executor with two slots; close it afterwards."""
        raise NotImplementedError("override the fixture `executor`")

    def test_results_and_requests_arrive_unchanged(self, executor: Executor, tmp_path: Path) -> None:
        requests = [request(tmp_path, 0), request(tmp_path, 1, seed=2**31 - 1, fidelity=0.1, attempt=3)]
        jobs = [executor.submit(callbacks.echo, r) for r in requests]
        for job, sent in zip(jobs, requests, strict=True):
            assert outcome(job) == callbacks.echo(sent)
            assert job.result() == outcome(job)

    def test_a_large_result_arrives(self, executor: Executor, tmp_path: Path) -> None:
        sent = request(tmp_path, 0)
        assert outcome(executor.submit(callbacks.large, sent)) == callbacks.large(sent)

    def test_a_result_that_cannot_be_pickled_arrives(self, executor: Executor, tmp_path: Path) -> None:
        assert outcome(executor.submit(callbacks.subclass, request(tmp_path, 0))) == EvalResult(0.5)

    def test_the_work_folder_is_made(self, executor: Executor, tmp_path: Path) -> None:
        sent = request(tmp_path / "new" / "folder", 0)
        assert outcome(executor.submit(callbacks.echo, sent)).ok
        assert sent.workdir.is_dir()

    def test_many_small_evaluations_use_both_slots_and_no_more(self, executor: Executor, tmp_path: Path) -> None:
        assert executor.slots == 2
        jobs = [executor.submit(callbacks.interval, request(tmp_path, i, x=float(i))) for i in range(10)]
        results = [outcome(job) for job in jobs]
        assert [r.mean for r in results] == list(range(10))
        spans = [(r.extras["begin"], r.extras["end"]) for r in results]
        assert max(sum(begin <= time < end for begin, end in spans) for time, _ in spans) <= 2

    def test_two_evaluations_run_at_the_same_time(self, executor: Executor, tmp_path: Path) -> None:
        sent = [request(tmp_path, i) for i in range(2)]
        jobs = [executor.submit(callbacks.wait_for_go, r) for r in sent]
        for r in sent:
            begun(r)
        assert not any(job.done() for job in jobs)
        (tmp_path / "go").touch()
        assert [outcome(job) for job in jobs] == [EvalResult(0.5)] * 2

    @pytest.mark.parametrize(
        ("callback", "status", "words"),
        [
            (callbacks.infeasible, "infeasible", "the legs collide"),
            (callbacks.raise_error, "crash", "three legs"),
            (callbacks.raise_unpicklable, "crash", "3 legs on go2"),
            (callbacks.raise_speechless, "crash", "SpeechlessError"),
            (callbacks.raise_exit, "crash", "no more legs"),
            (callbacks.raise_os_error, "lost", "no space left"),
            (callbacks.raise_memory_error, "crash", "no room for legs"),
            (callbacks.nan, "diverged", "mean is nan"),
            (callbacks.smuggled_nan, "diverged", "mean is nan"),
            (callbacks.wrong_type, "crash", "returned float; it must return an EvalResult"),
        ],
    )
    def test_failures_keep_their_kind_and_cause(
        self, executor: Executor, tmp_path: Path, callback: Callback, status: str, words: str
    ) -> None:
        result = outcome(executor.submit(callback, request(tmp_path, 0)))
        assert (result.status, words in result.message) == (status, True), result

    @pytest.mark.parametrize("callback", [callbacks.exit_process, callbacks.kill_process])
    def test_a_process_that_dies_harms_no_other(self, executor: Executor, tmp_path: Path, callback: Callback) -> None:
        if not self.isolated:
            pytest.skip("evaluations share a process")
        sibling = executor.submit(callbacks.wait_for_go, request(tmp_path, 0))
        begun(request(tmp_path, 0))
        dead = outcome(executor.submit(callback, request(tmp_path, 1)))
        assert dead.status == "crash"
        assert dead.message
        (tmp_path / "go").touch()
        assert outcome(sibling) == EvalResult(0.5)
        assert outcome(executor.submit(callbacks.echo, request(tmp_path, 2))).ok

    def test_an_evaluation_that_hangs_is_killed_at_its_deadline(self, executor: Executor, tmp_path: Path) -> None:
        if not self.isolated:
            pytest.skip("what runs cannot be stopped")
        start = time.time()
        assert outcome(executor.submit(callbacks.echo, request(tmp_path, 0))).ok
        deadline = time.time() + 3 + 4 * (time.time() - start)  # so that it can begin on a slow machine, too
        job = executor.submit(callbacks.wait_for_go, request(tmp_path, 1, deadline=deadline))
        process = begun(request(tmp_path, 1))
        assert outcome(job).status == "timeout"
        gone(process)

    def test_cancelling_is_final_even_if_a_result_comes_late(self, executor: Executor, tmp_path: Path) -> None:
        sent = request(tmp_path, 0)
        job = executor.submit(callbacks.wait_for_go, sent)
        process = begun(sent)
        job.cancel()
        job.cancel()
        assert outcome(job).status == "lost"
        if self.isolated:
            gone(process)
        (tmp_path / "go").touch()
        assert outcome(executor.submit(callbacks.echo, request(tmp_path, 1))).ok
        if self.isolated:
            assert not (sent.workdir / "ended").exists()
        else:
            until((sent.workdir / "ended").exists)
        assert job.done()
        assert job.result().status == "lost"

    def test_what_waits_for_a_slot_can_be_cancelled(self, executor: Executor, tmp_path: Path) -> None:
        running = [executor.submit(callbacks.wait_for_go, request(tmp_path, i)) for i in range(2)]
        begun(request(tmp_path, 0))
        begun(request(tmp_path, 1))
        waiting = executor.submit(callbacks.wait_for_go, request(tmp_path, 2))
        waiting.cancel()
        assert outcome(waiting).status == "lost"
        (tmp_path / "go").touch()
        assert [outcome(job) for job in running] == [EvalResult(0.5)] * 2
        assert outcome(executor.submit(callbacks.echo, request(tmp_path, 3))).ok
        assert not (self.isolated and (tmp_path / "2" / "begun").exists())

    def test_cancelling_what_is_done_changes_nothing(self, executor: Executor, tmp_path: Path) -> None:
        job = executor.submit(callbacks.subclass, request(tmp_path, 0))
        before = outcome(job)
        job.cancel()
        assert job.done()
        assert job.result() == before == EvalResult(0.5)

    def test_closing_ends_everything(self, executor: Executor, tmp_path: Path) -> None:
        jobs = [executor.submit(callbacks.wait_for_go, request(tmp_path, i)) for i in range(3)]
        processes = [begun(request(tmp_path, i)) for i in range(2)]
        if not self.isolated:
            (tmp_path / "go").touch()
        executor.close()
        executor.close()
        assert all(job.done() for job in jobs)
        if self.isolated:
            assert {job.result().status for job in jobs} == {"lost"}
        for process in {*processes} - {os.getpid()}:
            gone(process)
        with pytest.raises(RuntimeError):
            executor.submit(callbacks.echo, request(tmp_path, 4))


def request(
    folder: Path,
    trial: int,
    x: float = 0.5,
    attempt: int = 1,
    seed: int = 0,
    fidelity: float = 1.0,
    deadline: float | None = None,
) -> EvalRequest:
    """Return a request whose work folder is `folder/<trial>`."""
    params = {"x": x, "y": 0.1 + 0.2}
    return EvalRequest(trial, attempt, params, seed, fidelity, folder / str(trial), deadline)


def outcome(job: Job) -> EvalResult:
    """Return the result of a job, polled as a coordinator does."""
    until(job.done)
    return job.result()


def begun(sent: EvalRequest) -> int:
    """Wait until `wait_for_go` has begun; return the number of its process."""
    file = sent.workdir / "begun"
    until(file.exists)
    return int(file.read_text())


def gone(process: int) -> None:
    """Wait until a process has ended."""

    def ended() -> bool:
        try:
            return psutil.Process(process).status() == psutil.STATUS_ZOMBIE
        except psutil.NoSuchProcess:
            return True

    until(ended)


def until(condition: Callable[[], bool]) -> None:
    """Wait until a condition holds, or fail after five minutes."""
    end = time.monotonic() + callbacks.WAIT
    while not condition():
        assert time.monotonic() < end, "nothing happened for five minutes"
        time.sleep(0.02)
