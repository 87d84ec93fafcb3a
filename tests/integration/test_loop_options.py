"""Other objectives, other design spaces, and the report on its own: each a whole run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow


def params(folder: Path) -> list[dict[str, float]]:
    return [trial["params"] for trial in json.loads((folder / "trials.json").read_text())]


def test_objective_return(finished_return) -> None:
    assert finished_return.code == 0, finished_return.output
    assert "Fine-tuning maximises the discounted reward" in (finished_return.folder / "report.html").read_text()
    for trial in json.loads((finished_return.folder / "trials.json").read_text()):
        assert trial["result"]["mean"] == pytest.approx(trial["result"]["extras"]["return"])


def test_shanks_only_for_energy(run_smoke: Callable, tmp_path: Path) -> None:
    """The paper's search on hardware: shanks in [1.0, 1.4], thighs as they are."""
    done = run_smoke(
        tmp_path / "run",
        *("--objective", "energy", "--bounds", "front_shank=1:1.4", "hind_shank=1:1.4"),
        *("--fix", "front_thigh=1", "hind_thigh=1"),
    )
    assert done.code == 0, done.output
    tried = params(done.folder)
    assert {(p["front_thigh"], p["hind_thigh"]) for p in tried} == {(1.0, 1.0)}
    assert all(1.0 <= p[name] <= 1.4 for p in tried for name in ("front_shank", "hind_shank"))
    assert len({(p["front_shank"], p["hind_shank"]) for p in tried}) == len(tried)
    assert "for energy" in (done.folder / "report.html").read_text()


def test_one_free_parameter(run_smoke: Callable, tmp_path: Path) -> None:
    done = run_smoke(tmp_path / "run", "--fix", "front_thigh=1", "front_shank=1.1", "hind_thigh=1", "--trials", "3")
    assert done.code == 0, done.output
    tried = params(done.folder)
    assert len(tried) == 3
    assert {(p["front_thigh"], p["front_shank"], p["hind_thigh"]) for p in tried} == {(1.0, 1.1, 1.0)}


def test_another_seed_is_another_run(run_smoke: Callable, finished_return, tmp_path: Path) -> None:
    done = run_smoke(tmp_path / "run", "--objective", "return", "--seed", "1")
    assert done.code == 0, done.output
    first, second = (json.loads((f / "trials.json").read_text()) for f in (finished_return.folder, done.folder))
    assert {t["seed"] for t in first}.isdisjoint(t["seed"] for t in second)
    assert first[0]["params"] == second[0]["params"]
    assert all(a["params"] != b["params"] for a, b in zip(first[1:], second[1:], strict=True))


def test_report_alone(finished, codesign: Callable, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(finished.folder, folder)
    (folder / "report.html").unlink()
    code, output = codesign("report", folder)
    assert code == 0, output
    assert output.strip() == str(folder / "report.html")
    assert "Best against nominal" in (folder / "report.html").read_text()


def test_report_without_opengl(finished, codesign: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A video of stick figures, and a word saying so."""
    folder = tmp_path / "run"
    shutil.copytree(finished.folder, folder)
    monkeypatch.setenv("MUJOCO_GL", "disable")
    code, output = codesign("report", folder)
    assert code == 0, output
    page = (folder / "report.html").read_text()
    assert "drawn as stick figures, since no OpenGL was found" in page
    assert "data:video/mp4;base64," in page
