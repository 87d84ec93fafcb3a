"""The README's example is the script, and the script survives kill -9."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from codesign_bo import open_study

PACKAGE = Path(__file__).parents[2] / "packages" / "codesign_bo"
SCRIPT = PACKAGE / "examples" / "four_workers.py"


def test_the_readme_shows_the_script():
    assert f"```python\n{SCRIPT.read_text()}```" in (PACKAGE / "README.md").read_text()


def finished(path):
    try:
        with open_study(path) as view:
            return [t for t in view.trials() if t.result is not None]
    except Exception:  # not there yet
        return []


def just_begun(path):
    """Whether an evaluation of a second began within the last half."""
    with open_study(path) as view:
        return any(a.status == "running" and time.time() - a.started < 0.5 for a in view.attempts())


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_killed_half_way_the_example_goes_on(tmp_path):
    path = tmp_path / "four_workers" / "study.sqlite"
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(SCRIPT)]
    with open(tmp_path / "first.txt", "w") as log:
        first = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=log, stdout=log)
    waited = time.monotonic() + 1200
    while len(finished(path)) < 6 or not just_begun(path):
        assert time.monotonic() < waited
        assert first.poll() is None, (tmp_path / "first.txt").read_text()
        time.sleep(0.05)
    first.send_signal(signal.SIGKILL)
    first.wait(60)
    before = finished(path)
    assert 6 <= len(before) < 20
    second = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=1500)
    assert second.returncode == 0, second.stderr
    assert "20/20" in second.stderr
    assert "recommended: trial" in second.stdout
    with open_study(path) as view:
        trials = view.trials()
        assert [t.trial for t in trials] == list(range(20))
        assert all(t.result is not None for t in trials)
        assert [trials[t.trial] for t in before] == before  # nothing was done again
        search = [a for a in view.attempts() if a.repeat is None]
        assert sum(a.final for a in search) == 20
        cut = [a for a in search if a.status == "interrupted"]
        assert 1 <= len(cut) <= 4
        again = {a.trial: a for a in search if a.attempt == 2}
        assert {a.trial for a in cut} == set(again)  # the same trial, and so the same design and seed
        # the true optimum is at 1.2, 1.2 with 10; the nominal design has 8
        best = view.recommend()
        assert best.source == "confirmation"
        assert best.low > 0.0
        assert all(abs(best.params[name] - 1.2) < 0.15 for name in ("thigh", "shank"))
        assert {t.params["thigh"] + t.params["shank"] > 2.7 for t in trials if t.failed} <= {True}
    pictures = {p.name for p in (tmp_path / "four_workers" / "plots").iterdir()}
    expected = {"convergence", "slices", "landscape", "sensitivity", "calibration", "timeline"}
    assert pictures == {f"{name}.png" for name in expected} | {"index.html"}
