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
from codesign_bo.storage import Storage

SPACE = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)
commit = Storage._transaction


def session(path, kill_at=None, kill_trial=None):
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
        noise = np.random.default_rng(request.seed).normal(0, 0.05)
        return EvalResult(noise - (request.params["a"] - 0.7) ** 2 - request.params["b"] ** 2, 0.05, 1)

    Storage._transaction = watched
    with Study(SPACE, path, seed=11, n_init=4) as study:
        study.enqueue([{"a": 0.9, "b": 0.1}])
        study.run(evaluate, until=6)
        study.confirm(evaluate, top_k=1, repeats=2)
    return steps


def outcome(path):
    with open_study(path) as view:
        trials = [[t.trial, t.params, t.seed, t.origin, t.result.to_json()] for t in view.trials()]
        runs = [[c.trial, c.repeat, c.seed, c.result.to_json()] for c in view.confirmations()]
        return [trials, runs, [[q.params, q.trial] for q in view.queue()]]


def forked(path, **kill):
    pid = os.fork()
    if pid == 0:
        session(path, **kill)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


folder = Path(tempfile.mkdtemp(dir=sys.argv[1]))
kills = json.loads(sys.argv[2])
report = []
for i, kill in enumerate(kills):
    path = folder / f"{i}.sqlite"
    report.append([forked(path, **kill), forked(path), outcome(path)])
steps = session(folder / "whole.sqlite")
print(json.dumps({"whole": outcome(folder / "whole.sqlite"), "steps": steps, "killed": report}))
"""


def check(tmp_path: Path, kills: list[dict[str, int]]) -> int:
    script = tmp_path / "session.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path), json.dumps(kills)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    trials, confirmations, queue = report["whole"]
    assert [t[3] for t in trials] == ["nominal", "queued", "sobol", "sobol", "surrogate", "surrogate"]
    assert (len(confirmations), len(queue)) == (4, 1)
    for kill, (killed, resumed, outcome) in zip(kills, report["killed"], strict=True):
        assert killed == -9, kill
        assert resumed == 0, kill
        assert outcome == report["whole"], kill
    return report["steps"]


def test_a_killed_study_resumes_to_the_same_table(tmp_path):
    kills = [{"kill_at": k} for k in (1, 4, 7, 24, 31)]
    check(tmp_path, [*kills, {"kill_trial": 5}])


@pytest.mark.slow
def test_killed_at_any_half_commit_a_study_resumes_to_the_same_table(tmp_path):
    steps = check(tmp_path, [])
    assert steps >= 2 * (2 + 1 + 12 + 8)  # schema, header, queue, 6 trials and 4 confirmations
    check(tmp_path, [{"kill_at": k} for k in range(1, steps + 1)])
