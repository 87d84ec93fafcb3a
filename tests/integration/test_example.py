"""The README's script: the packages composed by hand, for a robot and a reward term of one's own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import deploy
import mcap.reader
import pytest
from codesign_bo import open_study
from locorl import load_policy
from morphgen import BodyFactory

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "examples" / "by_hand.py"


def test_the_readme_shows_the_script() -> None:
    text = SCRIPT.read_text()
    assert f"```python\n{text}```" in (ROOT / "README.md").read_text()
    assert sum(bool(line.strip()) for line in text.splitlines()) <= 40


@pytest.mark.slow
def test_the_script_runs(go2: BodyFactory, tmp_path: Path) -> None:
    """On a URDF that the project does not ship, with little of everything."""
    (tmp_path / "wolf.urdf").write_text(go2.urdf([1.05, 0.95, 1.0, 1.0]))
    options = ("--folder", "run", "--robots", "32", "--iterations", "2", "--trials", "3")
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--urdf", "wolf.urdf", *options],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=500,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    assert "recommended: " in done.stdout
    run = tmp_path / "run"
    with open_study(run / "study.sqlite") as study:
        assert all(trial.ok for trial in study.trials())
        best = study.recommend()
    assert load_policy(run / "trials" / "0000" / "policy.pt").card.task.reward.own == (("by_hand:hard_landing", -0.05),)
    assert dict(deploy.load_bundle(run / "bundle").robot.design) == pytest.approx(dict(best.params))
    with (run / "rollout.mcap").open("rb") as log:
        assert mcap.reader.make_reader(log).get_summary() is not None
