"""Whole studies in real processes: workers and coordinators that die, hang, grow and lie."""

import subprocess
import sys
import time

import pytest
from codesign_bo import BoxSpace, Study, open_study
from codesign_bo.executors import LocalExecutor
from codesign_bo.testing.executors import gone, until

SPACE = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)

CALLBACKS = """
import math, os, signal, sys, threading, time

from codesign_bo import EvalResult


class UnpicklableError(Exception):
    def __init__(self, legs, robot):
        super().__init__(f"{legs} legs on {robot}")
        self.lock = threading.Lock()


def good(request):
    return EvalResult(1.0 - (request.params["a"] - 0.7) ** 2, 0.1, 4)


def faulty(request):
    (request.workdir / f"pid-{request.attempt}").write_text(str(os.getpid()))
    match request.trial:
        case 7:
            os.kill(os.getpid(), signal.SIGKILL)
        case 8:
            time.sleep(1000)
        case 9:
            block = b"x" * 10**9
            time.sleep(1000)
        case 10:
            return EvalResult(math.nan)
        case 11:
            os.fork()
        case 12:
            raise UnpicklableError(3, "go2")
        case 13:
            if request.attempt == 1:
                raise OSError("a disk went away")
        case 14:
            sys.exit("no more legs")
    return good(request)


def held(request):
    (request.workdir / "pid").write_text(str(os.getpid()))
    while not (request.workdir.parent.parent / "go").exists() and request.trial > 2:
        time.sleep(0.02)
    return good(request)
"""

COORDINATOR = """
import sys
from codesign_bo import BoxSpace, Study
from codesign_bo.executors import LocalExecutor

if __name__ == "__main__":
    import faults
    space = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)
    with Study(space, sys.argv[1], seed=4, n_init=100) as study, LocalExecutor(slots=2) as executor:
        study.run(faults.held, until=7, executor=executor)
"""


@pytest.fixture
def faults(tmp_path, monkeypatch):
    """The callbacks, in a module that every process finds."""
    (tmp_path / "faults.py").write_text(CALLBACKS)
    (tmp_path / "coordinator.py").write_text(COORDINATOR)
    monkeypatch.syspath_prepend(tmp_path)
    import faults  # pyright: ignore[reportMissingImports]

    yield faults
    del sys.modules["faults"]


@pytest.mark.slow
def test_each_fault_of_a_worker_is_told_apart_and_counts_once(faults, tmp_path):
    began = time.monotonic()
    with Study(SPACE, tmp_path / "t.sqlite", n_init=100) as study, LocalExecutor() as executor:
        assert study.run(faults.good, until=1, executor=executor)[0].ok
    timeout = 5.0 + 5.0 * (time.monotonic() - began)  # so that the others are in time on a slow machine
    with (
        Study(SPACE, tmp_path / "s.sqlite", seed=4, n_init=100, workdir=tmp_path / "work") as study,
        LocalExecutor(slots=2, timeout=timeout, memory=6 * 10**8) as executor,
    ):
        trials = study.run(faults.faulty, until=15, executor=executor)
        assert study.finished() == 15
        attempts = study.attempts()
    assert all(t.result == faults.good(t) for t in trials if t.ok)
    expected = {7: "crash", 8: "timeout", 9: "crash", 10: "diverged", 12: "crash", 14: "crash"}
    assert {t.trial: t.status for t in trials if not t.ok} == expected
    words = {
        7: "SIGKILL",
        8: "no result",
        9: "out of memory",
        10: "mean is nan",
        12: "3 legs on go2",
        14: "no more legs",
    }
    assert all(said in trials[trial].result.message for trial, said in words.items())
    assert {t.trial: t.attempts for t in trials if t.attempts > 1} == {10: 2, 13: 2}
    assert [a.status for a in attempts if a.trial == 13] == ["lost", "ok"]
    assert sum(a.final for a in attempts) == 15
    for file in (tmp_path / "work").glob("*/pid-*"):
        gone(int(file.read_text()))


@pytest.mark.slow
def test_a_killed_coordinator_takes_its_workers_along_and_its_successor_ends_the_same_study(faults, tmp_path):
    path, trials = tmp_path / "s.sqlite", tmp_path / "trials"

    def started():
        return subprocess.Popen([sys.executable, tmp_path / "coordinator.py", path], cwd=tmp_path)

    killed = started()
    waiting = [trials / f"{i:04d}" / "pid" for i in (3, 4)]
    until(lambda: killed.poll() is not None or all(f.exists() and f.read_text() for f in waiting))
    workers = [int(f.read_text()) for f in waiting]
    killed.kill()
    killed.wait()
    for worker in workers:
        gone(worker)
    with open_study(path) as view:  # also right after kill -9
        assert [t.status for t in view.trials()] == ["ok"] * 3 + ["unfinished"] * 2
        assert {a.status for a in view.attempts() if a.trial > 2} == {"running"}
    (tmp_path / "go").touch()
    assert started().wait() == 0
    with open_study(path) as view:
        resumed = view.trials()
        assert [t.attempts for t in resumed] == [1, 1, 1, 2, 2, 1, 1]
        assert [a.status for a in view.attempts() if a.trial == 3] == ["interrupted", "ok"]
    with Study(SPACE, tmp_path / "whole.sqlite", seed=4, n_init=100) as study:
        assert study.run(faults.good, until=7) == resumed


@pytest.mark.slow
def test_a_second_coordinator_is_turned_away_while_the_first_goes_on(faults, tmp_path):
    command = [sys.executable, tmp_path / "coordinator.py", tmp_path / "s.sqlite"]
    first = subprocess.Popen(command, cwd=tmp_path)
    pid = tmp_path / "trials" / "0003" / "pid"
    until(lambda: first.poll() is not None or pid.exists())
    second = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert second.returncode == 1
    assert f"in use by another coordinator (process {first.pid})" in second.stderr
    (tmp_path / "go").touch()
    assert first.wait() == 0
    with open_study(tmp_path / "s.sqlite") as view:
        assert [(t.status, t.attempts) for t in view.trials()] == [("ok", 1)] * 7


LIGHT = """
import sys
from codesign_bo import BoxSpace, EvalRequest, EvalResult, LinearConstraint, MedianStopping, Study, open_study
from codesign_bo.executors import LocalExecutor

def evaluate(request: EvalRequest) -> EvalResult:
    heavy = {"torch", "gpytorch", "botorch"} & {*sys.modules}
    return EvalResult(request.params["a"], message=" ".join(heavy))

if __name__ == "__main__":
    space = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)
    with Study(space, sys.argv[1]) as study, LocalExecutor() as executor:
        (trial,) = study.run(evaluate, until=1, executor=executor)
    sys.exit(0 if trial.ok and trial.result.message == "" else repr(trial.result))
"""


def test_the_process_of_an_evaluation_does_not_load_torch(tmp_path):
    """Although it imports the script again, as `spawn` does: that would take seconds and 300 MB for nothing."""
    script = tmp_path / "light.py"
    script.write_text(LIGHT)
    done = subprocess.run([sys.executable, script, tmp_path / "s.sqlite"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_script_without_a_main_guard_is_told_so(tmp_path):
    script = tmp_path / "careless.py"
    script.write_text(LIGHT.replace('if __name__ == "__main__":', "if True:"))
    done = subprocess.run([sys.executable, script, tmp_path / "s.sqlite"], capture_output=True, text=True)
    assert done.returncode == 1
    with open_study(tmp_path / "s.sqlite") as view:
        (trial,) = view.trials()
    assert trial.status == "crash"
    assert "lacks `if __name__ == '__main__':`" in trial.result.message
