"""kill -9 at every commit, before and after it, and inside evaluations; then resume."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = r"""
import json, os, signal, sys, tempfile
from contextlib import contextmanager
from pathlib import Path
import torch
torch.set_num_threads(1)
import numpy as np
from codesign_bo import BoxSpace, EvalResult, Study, open_study
from codesign_bo.running.evaluation import evaluate as evaluate_safely
from codesign_bo.storage import Storage

SPACE = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)
commit = Storage._transaction


class InOrder:
    # A parallel executor whose evaluations end in the order of their trials (or seeds), one at a time.
    slots = 3

    def __init__(self):
        self.jobs = []

    def submit(self, callback, request):
        self.jobs.append(Job(self, callback, request))
        return self.jobs[-1]


class Job:
    def __init__(self, executor, callback, request):
        self.executor, self.callback, self.request = executor, callback, request
        self.key = (-1 if request.repeat is None else request.repeat, request.trial)

    def done(self):
        return self is min(self.executor.jobs, key=lambda job: job.key)

    def result(self):
        self.executor.jobs.remove(self)
        return evaluate_safely(self.callback, self.request)

    def cancel(self):
        pass


def session(path, kill_at=None, kill_trial=None, parallel=False):
    # Run and confirm a study; die at the given half-commit or inside the given trial's first attempt.
    steps = 0

    def step():
        nonlocal steps
        steps += 1
        if steps == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)

    @contextmanager
    def watched(self):
        with commit(self):
            yield
            step()
        step()

    def evaluate(request):
        if request.trial == kill_trial and request.attempt == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        if request.trial == 2:
            raise ValueError("this design falls")
        if (request.trial, request.repeat) in ((1, None), (0, 1)) and request.attempt == 1:
            return EvalResult.failure("lost", "the machine went away")
        if request.trial == 5 and request.repeat is None and request.attempt < 3:
            return EvalResult.failure("diverged" if request.attempt == 1 else "lost", "once")
        noise = np.random.default_rng(request.seed).normal(0, 0.05)
        return EvalResult(noise - (request.params["a"] - 0.7) ** 2 - request.params["b"] ** 2, 0.05, 1)

    Storage._transaction = watched
    with Study(SPACE, path, seed=11, n_init=5) as study:
        study.add_screening([{"a": 0.9, "b": 0.1}, {"a": 0.1, "b": 0.9}], [2.0, 1.0])
        study.enqueue_screened(1)
        with open_study(PAST) as past:
            study.add_history(past)
        study.run(evaluate, until=7, executor=InOrder() if parallel else None)
        study.confirm(evaluate, top_k=1, repeats=2, executor=InOrder() if parallel else None)
    return steps


def outcome(path):
    with open_study(path) as view:
        trials = [[t.trial, t.params, t.seed, t.origin, t.result.to_json()] for t in view.trials()]
        pending = [list(t.basis.pending) for t in view.trials() if t.basis is not None]
        runs = [[c.trial, c.repeat, c.seed, c.result.to_json()] for c in view.confirmations()]
        return [trials, runs, [[q.params, q.trial] for q in view.queue()], pending]


def forked(path, **kill):
    pid = os.fork()
    if pid == 0:
        session(path, parallel=parallel, **kill)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


folder = Path(tempfile.mkdtemp(dir=sys.argv[1]))
PAST = folder / "past.sqlite"
with Study(SPACE, PAST, seed=5) as past:
    past.run(lambda request: EvalResult(-request.params["a"], 0.1), until=1)
kills = json.loads(sys.argv[2])
parallel = sys.argv[3] == "parallel"
report = []
for i, kill in enumerate(kills):
    path = folder / f"{i}.sqlite"
    report.append([forked(path, **kill), forked(path), outcome(path)])
steps = session(folder / "whole.sqlite", parallel=parallel)
print(json.dumps({"whole": outcome(folder / "whole.sqlite"), "steps": steps, "killed": report}))
"""


def check(tmp_path: Path, kills: list[dict[str, int]], mode: str) -> int:
    script = tmp_path / "session.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path), json.dumps(kills), mode], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    trials, confirmations, queue, pending = report["whole"]
    assert [t[3] for t in trials] == ["nominal", "queued", "sobol", "sobol", "surrogate", "surrogate", "surrogate"]
    assert (len(confirmations), len(queue)) == (4, 1)
    assert [len(p) for p in pending] == ([2, 2, 2] if mode == "parallel" else [0, 0, 0])
    for kill, (killed, resumed, outcome) in zip(kills, report["killed"], strict=True):
        assert killed == -9, kill
        assert resumed == 0, kill
        assert outcome == report["whole"], kill
    return report["steps"]


MODES = pytest.mark.parametrize("mode", ["sequential", "parallel"])


@MODES
def test_a_killed_study_resumes_to_the_same_table(tmp_path, mode):
    check(tmp_path, [{"kill_at": 13}, {"kill_at": 44}, {"kill_trial": 5}], mode)


@MODES
@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_killed_at_any_half_commit_a_study_resumes_to_the_same_table(tmp_path, mode):
    steps = check(tmp_path, [], mode)
    assert steps >= 2 * (2 + 3 + 14 + 8 + 8)  # schema, header, what is suggested, 7 trials, 4 confirmations, 4 retries
    check(tmp_path, [{"kill_at": k} for k in range(1, steps + 1)], mode)
