"""The executors that need nothing but this package pass the contract."""

import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pytest
from codesign_bo.executors import FuturesExecutor, LocalExecutor, RayExecutor, SlurmExecutor
from codesign_bo.testing import callbacks
from codesign_bo.testing.executors import ExecutorContract, begun, outcome, request


@pytest.mark.slow
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


@pytest.mark.slow
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


class UnwillingPool(ThreadPoolExecutor):
    def submit(self, *args, **kwargs):
        return super().submit(int, "a worker says no")


def test_a_fault_of_the_pool_is_no_fault_of_the_design(tmp_path):
    with FuturesExecutor(UnwillingPool(1), slots=1) as executor:
        result = outcome(executor.submit(callbacks.echo, request(tmp_path, 0)))
    assert result.status == "lost"
    assert "a worker says no" in result.message


def test_no_slots_are_refused():
    with pytest.raises(ValueError, match="slots is 0"):
        LocalExecutor(slots=0)
    with pytest.raises(ValueError, match="slots is 0"):
        FuturesExecutor(ThreadPoolExecutor(1), slots=0)


@pytest.mark.parametrize(
    ("module", "make"),
    [("ray", lambda: RayExecutor(slots=1)), ("submitit", lambda: SlurmExecutor(1, "jobs", timeout_min=5))],
)
def test_a_missing_extra_is_named(module, make, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    extra = {"ray": "ray", "submitit": "slurm"}[module]
    with pytest.raises(ImportError, match=rf"pip install 'legged-codesign-bo\[{extra}\]'"):
        make()


def test_clusters_are_imported_only_when_used():
    code = "import sys, codesign_bo.executors; assert not {'ray', 'submitit'} & {*sys.modules}"
    subprocess.run([sys.executable, "-c", code], check=True)
