"""LocalExecutor: limits, logs, leftovers, and what remains when the coordinator is killed."""

import atexit
import ctypes
import importlib
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from codesign_bo import EvalResult
from codesign_bo.executors import LocalExecutor, local
from codesign_bo.testing import callbacks
from codesign_bo.testing.executors import begun, gone, outcome, request, until

# every trial is a fresh process
pytestmark = pytest.mark.slow

GB = 10**9

# --- callbacks ----------------------------------------------------------------------------------------


def sleeper(sent, name, new_session):
    process = subprocess.Popen(["sleep", "1000"], start_new_session=new_session)
    (sent.workdir / name).write_text(str(process.pid))


def with_child(sent):
    sleeper(sent, "child", new_session=False)
    return callbacks.wait_for_go(sent)


def with_children(sent):
    sleeper(sent, "emigrant", new_session=True)
    return with_child(sent)


def leaves_a_child(sent):
    sleeper(sent, "child", new_session=False)
    return EvalResult(1.0)


def keeps_the_interpreter(sent):
    sleeper(sent, "child", new_session=False)
    (sent.workdir / "begun").write_text(str(os.getpid()))
    ctypes.PyDLL(None).sleep(1000)  # PyDLL, unlike CDLL, does not let other threads run


def child_takes_memory(sent):
    subprocess.run([sys.executable, "-c", f"block = b'x' * {GB}; import time; time.sleep({sent.params['x']})"])
    return EvalResult(1.0)


def visible_devices(sent):
    callbacks.wait_for_go(sent)
    return EvalResult(1.0, message=os.environ.get("CUDA_VISIBLE_DEVICES", "none"))


def talks(sent):
    print(f"printed by attempt {sent.attempt}")
    subprocess.run("echo from a child; echo complaint of a child >&2", shell=True)
    print(f"complaint of attempt {sent.attempt}", file=sys.stderr)
    os.kill(os.getpid(), signal.SIGKILL)


def segfaults(sent):
    ctypes.string_at(0)


def returns_twice(sent):
    os.fork()
    return EvalResult(float(os.getpid()))


def crashes_at_exit(sent):
    atexit.register(os._exit, 5)
    return EvalResult(1.0)


def hangs_at_exit(sent):
    threading.Thread(target=time.sleep, args=(1000,)).start()
    return EvalResult(float(os.getpid()))


def removes_its_folder(sent):
    shutil.rmtree(sent.workdir)
    sent.workdir.write_text("a file where the folder was")
    return EvalResult(1.0)


def works_in_its_folder(sent):
    os.chdir(sent.workdir)
    return EvalResult(1.0)


def succeeds_at_last(sent):
    return EvalResult(1.0) if sent.attempt == 3 else callbacks.raise_error(sent)


count = 0


def counts(sent):
    global count
    count += 1
    return EvalResult(float(count))


@pytest.fixture
def trials(monkeypatch):
    """This module by a name under which other processes find it, too."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    return importlib.import_module(Path(__file__).stem)


def number(file):
    until(lambda: file.exists() and file.read_text())
    return int(file.read_text())


# --- processes ----------------------------------------------------------------------------------------


def test_each_evaluation_has_a_fresh_process(trials, tmp_path):
    with LocalExecutor() as executor:
        jobs = [executor.submit(trials.counts, request(tmp_path, i)) for i in range(2)]
        assert [outcome(job) for job in jobs] == [EvalResult(1.0)] * 2
    assert trials.count == 0


def test_a_timeout_kills_children_too_even_in_a_session_of_their_own(trials, tmp_path):
    began = time.monotonic()
    with LocalExecutor() as executor:
        outcome(executor.submit(trials.counts, request(tmp_path, 0)))
    timeout = round(3 + 4 * (time.monotonic() - began))
    with LocalExecutor(timeout=timeout) as executor:
        job = executor.submit(trials.with_children, request(tmp_path, 1))
        processes = [number(tmp_path / "1" / name) for name in ("child", "emigrant", "begun")]
        assert not job.done()
        assert outcome(job) == EvalResult.failure("timeout", f"no result within {timeout}.0 s")
        for process in processes:
            gone(process)


def test_children_left_behind_by_an_evaluation_are_killed(trials, tmp_path):
    with LocalExecutor() as executor:
        assert outcome(executor.submit(trials.leaves_a_child, request(tmp_path, 0))) == EvalResult(1.0)
        gone(number(tmp_path / "0" / "child"))


def test_the_memory_limit_counts_children(trials, tmp_path):
    with LocalExecutor(memory=GB) as executor:
        result = outcome(executor.submit(trials.child_takes_memory, request(tmp_path, 0, x=1000.0)))
    assert result.status == "crash"
    found = re.fullmatch(r"out of memory: (.*) GB resident in 2 processes, the limit is 1.00 GB", result.message)
    assert 1.0 <= float(found[1]) < 2.0
    with LocalExecutor(memory=4 * GB) as executor:
        assert outcome(executor.submit(trials.child_takes_memory, request(tmp_path, 1, x=0.0))).ok


def test_each_slot_has_its_gpus(trials, tmp_path, monkeypatch):
    def seen(folder, **settings):
        with LocalExecutor(**settings) as executor:
            jobs = [executor.submit(trials.visible_devices, request(folder, i)) for i in range(executor.slots)]
            for i in range(executor.slots):
                begun(request(folder, i))
            (folder / "go").touch()
            return sorted(outcome(job).message for job in jobs)

    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "7")
    assert seen(tmp_path / "a", slots=2, gpus=[3, "0,1"]) == ["0,1", "3"]
    assert seen(tmp_path / "b", slots=4, gpus=[0, 1]) == ["0", "0", "1", "1"]
    assert seen(tmp_path / "c", slots=1) == ["7"]


# --- how it ended -------------------------------------------------------------------------------------


def test_logs_of_all_attempts_are_kept_and_a_crash_quotes_its_own(trials, tmp_path):
    with LocalExecutor() as executor:
        first, second = (outcome(executor.submit(trials.talks, request(tmp_path, 0, attempt=i))) for i in (1, 2))
    assert first.status == second.status == "crash"
    assert "SIGKILL" in second.message
    assert second.message.endswith("complaint of a child\ncomplaint of attempt 2")
    assert "attempt 1" not in second.message

    def lines(name):
        text = (tmp_path / "0" / name).read_text()
        return re.sub(r"--- trial 0, (attempt \d), .* ---", r"[\1]", text).splitlines()

    printed = ["printed by attempt {}", "from a child"]
    complaints = ["complaint of a child", "complaint of attempt {}"]
    for name, body in (("stdout.txt", printed), ("stderr.txt", complaints)):
        assert lines(name) == [line.format(i) for i in (1, 2) for line in ["[attempt {}]", *body]]


def test_a_fault_in_c_code_says_where(trials, tmp_path):
    with LocalExecutor() as executor:
        result = outcome(executor.submit(trials.segfaults, request(tmp_path, 0)))
    assert result.status == "crash"
    assert result.message.startswith("killed by SIGSEGV")
    assert "in segfaults" in (tmp_path / "0" / "stderr.txt").read_text()


def test_an_exit_code_is_named(tmp_path):
    with LocalExecutor() as executor:
        result = outcome(executor.submit(callbacks.exit_process, request(tmp_path, 0)))
    assert result == EvalResult.failure("crash", "ended with exit code 3 and no result")


def test_a_result_counts_whatever_the_process_does_afterwards(trials, tmp_path, monkeypatch):
    monkeypatch.setattr(local, "_EXIT_GRACE", 1.0)
    with LocalExecutor() as executor:
        assert outcome(executor.submit(trials.crashes_at_exit, request(tmp_path, 0))) == EvalResult(1.0)
        hung = outcome(executor.submit(trials.hangs_at_exit, request(tmp_path, 1)))
        assert hung.ok
        gone(int(hung.mean))


def test_a_callback_that_forks_and_returns_twice_counts_once(trials, tmp_path):
    with LocalExecutor() as executor:
        result = outcome(executor.submit(trials.returns_twice, request(tmp_path, 0)))
        gone(int(result.mean))
        assert result.ok
        assert [p.name for p in (tmp_path / "0").glob("result*")] == ["result-0-1.json"]
        assert outcome(executor.submit(callbacks.subclass, request(tmp_path, 1))) == EvalResult(0.5)


def test_a_relative_work_folder_holds_although_the_callback_changes_folders(trials, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with LocalExecutor() as executor:
        assert outcome(executor.submit(trials.works_in_its_folder, request(Path("runs"), 0))) == EvalResult(1.0)
    assert (tmp_path / "runs" / "0" / "result-0-1.json").exists()


def test_what_the_machine_spoils_is_lost(trials, tmp_path):
    (tmp_path / "file").touch()
    with LocalExecutor() as executor:
        no_folder = outcome(executor.submit(callbacks.echo, request(tmp_path / "file", 0)))
        not_written = outcome(executor.submit(trials.removes_its_folder, request(tmp_path, 1)))
    assert (no_folder.status, "could not be run" in no_folder.message) == ("lost", True)
    assert (not_written.status, "could not be written" in not_written.message) == ("lost", True)


def test_a_deadline_in_the_past_starts_nothing(tmp_path):
    with LocalExecutor() as executor:
        late = request(tmp_path, 0, deadline=time.time() - 1)
        assert outcome(executor.submit(callbacks.wait_for_go, late)).status == "timeout"
    assert not late.workdir.exists()


def test_setting_the_clock_ends_nothing(tmp_path, monkeypatch):
    with LocalExecutor(timeout=3600) as executor:
        sent = request(tmp_path, 0, deadline=time.time() + 3600)
        job = executor.submit(callbacks.wait_for_go, sent)
        begun(sent)
        now = time.time
        for jump in (1e6, -1e6):
            monkeypatch.setattr(time, "time", lambda jump=jump: now() + jump)
            time.sleep(0.5)
            assert not job.done()
        (tmp_path / "go").touch()
        assert outcome(job) == EvalResult(0.5)


# --- callbacks that cannot be sent --------------------------------------------------------------------


def test_a_callback_that_does_not_pickle_is_refused(tmp_path):
    with LocalExecutor() as executor, pytest.raises(TypeError, match="top level of a module"):
        executor.submit(lambda request: EvalResult(1.0), request(tmp_path, 0))


def test_a_callback_that_does_not_load_is_a_crash(tmp_path, monkeypatch):
    (tmp_path / "fickle.py").write_text("def evaluate(request): ...")
    monkeypatch.syspath_prepend(tmp_path)
    evaluate = importlib.import_module("fickle").evaluate
    (tmp_path / "fickle.py").write_text("")
    with LocalExecutor() as executor:
        result = outcome(executor.submit(evaluate, request(tmp_path, 0)))
    assert result.status == "crash"
    assert "Can't get attribute 'evaluate'" in result.message


@pytest.mark.parametrize(
    ("settings", "word"),
    [({"timeout": 0}, "timeout is 0"), ({"memory": -1}, "memory is -1"), ({"gpus": [0, 1]}, "set slots to 2")],
)
def test_bad_settings_are_refused(settings, word):
    with pytest.raises(ValueError, match=word):
        LocalExecutor(**settings)


# --- a coordinator that is killed ---------------------------------------------------------------------


def test_no_attempt_takes_the_result_of_another_unless_asked(tmp_path):
    def run(reuse, **fields):
        with LocalExecutor(reuse=reuse) as executor:
            return outcome(executor.submit(callbacks.interval, request(tmp_path, 0, **fields)))

    first = run(False)
    assert run(True, attempt=2) == first
    assert run(True, attempt=2, deadline=time.time() + 600) == first
    second = run(False, attempt=2)
    assert second != first
    assert run(True, attempt=3) == second
    assert run(True, attempt=3, seed=1).extras["begin"] > second.extras["end"]
    again = run(False)
    assert again not in (first, second)  # nor does the same attempt in a new study in this folder
    assert run(True) == again
    (tmp_path / "0" / "result-0-1.json").write_text('{"torn": ')
    assert run(True).ok


def test_a_failure_is_not_reused(trials, tmp_path):
    with LocalExecutor(reuse=True) as executor:
        jobs = [executor.submit(trials.succeeds_at_last, request(tmp_path, 0, attempt=i)) for i in (1, 2, 3, 4)]
        assert [outcome(job).status for job in jobs] == ["crash", "crash", "ok", "ok"]


SCRIPT = """
import sys, time
from pathlib import Path
from codesign_bo import EvalResult
from codesign_bo.executors import LocalExecutor
from codesign_bo.testing.executors import begun, request

def double(request):
    return EvalResult(2 * request.params["x"])

if __name__ == "__main__":
    sys.path.insert(0, sys.argv[1])
    import test_bo_executors_local as trials
    folder = Path(sys.argv[2])
    executor = LocalExecutor(slots=3)
    assert executor.submit(double, request(folder, 9)).result() == EvalResult(1.0)
    for i, callback in enumerate([trials.with_child, trials.keeps_the_interpreter]):
        executor.submit(callback, request(folder, i))
    for i in range(2):
        begun(request(folder, i))
    (folder / "ready").touch()
    if sys.argv[3] == "wait":
        time.sleep(1000)
    raise ValueError("the coordinator is wrong")
"""


@pytest.fixture
def coordinator(tmp_path):
    """Start a script that runs evaluations; give it and their processes once they run."""
    (tmp_path / "script.py").write_text(SCRIPT)
    started = []

    def start(ending):
        process = subprocess.Popen(
            [sys.executable, tmp_path / "script.py", Path(__file__).parent, tmp_path, ending], stderr=subprocess.PIPE
        )
        started.append(process)
        until(lambda: (tmp_path / "ready").exists() or process.poll() is not None)
        return process, [number(tmp_path / name) for name in ("0/begun", "0/child", "1/begun", "1/child")]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_a_killed_coordinator_leaves_no_process(coordinator):
    process, others = coordinator("wait")
    process.kill()
    for other in others:
        gone(other)


def test_a_coordinator_that_fails_before_closing_leaves_no_process_and_ends(coordinator):
    process, others = coordinator("fail")
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert errors.strip().endswith(b"ValueError: the coordinator is wrong")
    for other in others:
        gone(other)
