"""The executors that need nothing but this package pass the contract."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pytest
from codesign_bo.executors import FuturesExecutor, LocalExecutor
from codesign_bo.testing import callbacks
from codesign_bo.testing.executors import ExecutorContract, begun, outcome, request


class TestLocalExecutor(ExecutorContract):
    @pytest.fixture
    def executor(self):
        with LocalExecutor(slots=2) as executor:
            yield executor


class TestThreadPool(ExecutorContract):
    isolated = False

    @pytest.fixture
    def executor(self):
        with FuturesExecutor(ThreadPoolExecutor(2), slots=2) as executor:
            yield executor


class TestProcessPool(ExecutorContract):
    isolated = False

    @pytest.fixture
    def executor(self):
        with FuturesExecutor(ProcessPoolExecutor(2), slots=2) as executor:
            yield executor

    def test_a_broken_pool_loses_what_is_in_flight_and_takes_nothing_more(self, executor, tmp_path):
        sibling = executor.submit(callbacks.wait_for_go, request(tmp_path, 0))
        begun(request(tmp_path, 0))
        dead = executor.submit(callbacks.kill_process, request(tmp_path, 1))
        for job in (dead, sibling):
            assert outcome(job).status == "lost"
            assert "the pool broke" in job.result().message
        with pytest.raises(RuntimeError, match="give a new pool"):
            executor.submit(callbacks.echo, request(tmp_path, 2))

    def test_a_callback_that_does_not_pickle_is_refused(self, executor, tmp_path):
        with pytest.raises(TypeError, match="top level of a module"):
            executor.submit(lambda request: None, request(tmp_path, 0))


class NeverPool(ThreadPoolExecutor):
    def submit(self, *args, **kwargs):
        future = super().submit(int, "a worker says no")
        return future


def test_a_fault_of_the_pool_is_no_fault_of_the_design(tmp_path):
    with FuturesExecutor(NeverPool(1), slots=1) as executor:
        result = outcome(executor.submit(callbacks.echo, request(tmp_path, 0)))
    assert result.status == "lost"
    assert "a worker says no" in result.message


def test_no_slots_are_refused():
    with pytest.raises(ValueError, match="slots is 0"):
        LocalExecutor(slots=0)
    with pytest.raises(ValueError, match="slots is 0"):
        FuturesExecutor(ThreadPoolExecutor(1), slots=0)
