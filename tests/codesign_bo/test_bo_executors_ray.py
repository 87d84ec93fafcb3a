"""RayExecutor on a cluster of this machine alone."""

import psutil
import pytest
from codesign_bo import EvalResult
from codesign_bo.executors import RayExecutor
from codesign_bo.testing import callbacks
from codesign_bo.testing.executors import ExecutorContract, begun, gone, outcome, request

ray = pytest.importorskip("ray")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cluster():
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield
    ray.shutdown()


@pytest.fixture
def executor(cluster):
    with RayExecutor(slots=2) as executor:
        yield executor


class TestRayExecutor(ExecutorContract):
    @pytest.fixture
    def executor(self, cluster):
        with RayExecutor(slots=2) as executor:
            yield executor


def test_a_cluster_that_was_there_before_stays(cluster):
    RayExecutor(slots=1).close()
    assert ray.is_initialized()
    with pytest.raises(ValueError, match="slots is 0"):
        RayExecutor(slots=0)
    with pytest.raises(ValueError, match="timeout is -1"):
        RayExecutor(slots=1, timeout=-1)
    assert ray.is_initialized()


def test_any_function_will_do_even_a_lambda(executor, tmp_path):
    half = 0.5
    job = executor.submit(lambda sent: EvalResult(half * sent.params["x"]), request(tmp_path, 0, x=3.0))
    assert outcome(job) == EvalResult(1.5)


def test_limits_hold_on_the_node(cluster, tmp_path):
    with RayExecutor(slots=1, timeout=5) as executor:
        job = executor.submit(callbacks.wait_for_go, request(tmp_path, 0))
        assert outcome(job) == EvalResult.failure("timeout", "no result within 5.0 s")


def test_a_worker_of_ray_that_dies_takes_the_evaluation_with_it_and_nothing_else(executor, tmp_path):
    """Ray kills workers when a node is short of memory."""
    requests = [request(tmp_path, i) for i in range(2)]
    jobs = [executor.submit(callbacks.wait_for_go, sent) for sent in requests]
    processes = [begun(sent) for sent in requests]
    psutil.Process(processes[0]).parent().kill()
    assert outcome(jobs[0]).status == "lost"
    gone(processes[0])
    (tmp_path / "go").touch()
    assert outcome(jobs[1]) == EvalResult(0.5)
    assert outcome(executor.submit(callbacks.echo, request(tmp_path, 2))).ok
