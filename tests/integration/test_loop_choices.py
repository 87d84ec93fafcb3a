"""Other searches, other bodies, several seeds, several processes: each a whole run, as small as it may be."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import deploy
import numpy as np
import pytest
from locorl import load_policy
from morphgen import DesignSpace, GainRule, load_robot

from legged_codesign.report.data import RunData, read_run

pytestmark = pytest.mark.slow

FEW = ("--objective", "return", "--trials", "3", "--iterations", "1")


@pytest.fixture
def pretrained(finished_return, tmp_path: Path) -> Path:
    """A run folder with nothing but the generalist of another run of the same robot, task and seed."""
    assert finished_return.code == 0, finished_return.output
    folder = tmp_path / "run"
    shutil.copytree(finished_return.folder / "pretrain", folder / "pretrain")
    (folder / "stages").mkdir()
    shutil.copy(finished_return.folder / "stages" / "pretrain.json", folder / "stages")
    return folder


def whole(done) -> RunData:
    """What a run has to show that went to its end."""
    assert done.code == 0, done.output
    data = read_run(done.folder)
    assert data.choice is not None
    assert data.rollout is not None
    assert all(trial.status == "ok" for trial in data.trials), [trial.status for trial in data.trials]
    assert (done.folder / "report.html").stat().st_size > 100_000
    return data


def test_compromises(pretrained: Path, run_smoke: Callable) -> None:
    done = run_smoke(pretrained, *FEW, "--pareto")
    data = whole(done)
    assert "1/9 pretrain unchanged, skipped" in done.output
    energies = [trial.result.extras["energy"] for trial in data.trials if trial.result]
    assert len(set(energies)) == len(data.trials) == 3
    page = (done.folder / "report.html").read_text()
    assert "Compromises" in page
    assert "energy" in page


def test_random_search(pretrained: Path, run_smoke: Callable) -> None:
    done = run_smoke(pretrained, *FEW, "--search", "random")
    data = whole(done)
    assert "1/9 pretrain unchanged, skipped" in done.output
    assert len(data.trials) == 3
    screened = [row["params"] for row in data.screening]
    assert all(dict(trial.params) not in screened for trial in data.trials[1:]), "a baseline takes no screened body"
    assert dict(data.trials[0].params) == screened[0]


def test_wide_space(run_smoke: Callable, tmp_path: Path) -> None:
    data = whole(run_smoke(tmp_path / "run", *FEW, "--space", "wide"))
    names = DesignSpace.wide().names
    assert len(names) > 4
    assert all(tuple(trial.params) == names for trial in data.trials)
    moved = [[name for name in names if trial.params[name] != data.nominal[name]] for trial in data.trials[1:]]
    assert all(len(each) == len(names) for each in moved)
    assert data.choice is not None
    # the bundle is of the body that was chosen, beyond its legs
    mass = load_robot("go2", space=DesignSpace.wide()).batch(data.choice.design(names)).total_mass[0]
    assert manifest(data.folder)["robot"]["total_mass"] == pytest.approx(mass)


def test_gains_that_follow_the_body(run_smoke: Callable, tmp_path: Path) -> None:
    data = whole(run_smoke(tmp_path / "run", *FEW, "--gains", "stance"))
    assert data.choice is not None
    names = tuple(data.nominal)
    rule = load_robot("go2", gains=GainRule("stance"))
    tried = [np.array([trial.params[name] for name in names]) for trial in data.trials[1:]]
    assert all(not np.allclose(rule.batch(design).kp, 40.0) for design in tried), "the rule must do something here"
    chosen = rule.batch(data.choice.design(names))
    np.testing.assert_allclose([joint["kp"] for joint in manifest(data.folder)["joints"]], chosen.kp[0], rtol=1e-6)


def test_several_seeds(run_smoke: Callable, tmp_path: Path) -> None:
    done = run_smoke(tmp_path / "runs", *FEW, "--seeds", "3", "4")
    assert done.code == 0, done.output
    runs = [read_run(tmp_path / "runs" / f"seed-{seed}") for seed in (3, 4)]
    assert [run.settings["seed"] for run in runs] == [3, 4]
    assert all(run.choice and run.rollout and len(run.trials) == 3 for run in runs)
    first, second = ([dict(trial.params) for trial in run.trials] for run in runs)
    assert first[0] == second[0], "both begin with the nominal body"
    assert first[1:] != second[1:]
    assert runs[0].pretrain[-1]["reward"] != runs[1].pretrain[-1]["reward"]
    again = run_smoke(tmp_path / "runs", *FEW, "--seeds", "3", "4")
    assert again.output.count("unchanged, skipped") == 2 * 9, again.output


def test_two_processes(run_smoke: Callable, finished_return, tmp_path: Path) -> None:
    data = whole(run_smoke(tmp_path / "run", *FEW, "--processes", "2"))
    alone = read_run(finished_return.folder)
    assert [row["iteration"] for row in data.pretrain] == [row["iteration"] for row in alone.pretrain]
    # two halves of the robots draw other noise than the whole, and gather as many samples
    assert data.pretrain[-1]["samples"] == alone.pretrain[-1]["samples"]
    shared, own = (load_policy(folder / "pretrain" / "generalist.pt") for folder in (data.folder, alone.folder))
    assert shared.card.samples == own.card.samples


def manifest(folder: Path) -> Mapping[str, Any]:
    deploy.load_bundle(folder / "bundle")  # its checksums hold
    return json.loads((folder / "bundle" / "manifest.json").read_text())
