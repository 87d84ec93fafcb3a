"""The students that ship: intact, as good as their provenance says, and on their feet in deploy's simulation."""

from __future__ import annotations

import json
from pathlib import Path

import deploy
import pytest
from distill import load_student, verify_bundle
from locorl import load_policy

from legged_codesign.pretrained import shipped_bundle


@pytest.fixture(scope="module")
def bundle() -> Path:
    return shipped_bundle("go2-blind")


def test_the_bundle_is_intact(bundle: Path) -> None:
    assert max(verify_bundle(bundle).errors.values()) <= 1e-5


def test_it_is_small(bundle: Path) -> None:
    assert sum(path.stat().st_size for path in bundle.parent.rglob("*") if path.is_file()) < 10_000_000


def test_student_and_teacher_lie_beside_it(bundle: Path) -> None:
    teacher = load_policy(bundle.parent / "teacher.pt")
    assert teacher.card.robot == json.loads((bundle / "manifest.json").read_text())["robot"]["name"]
    load_student(bundle.parent / "student.pt", teacher)


def test_recorded_comparison_meets_the_target(bundle: Path) -> None:
    record = json.loads((bundle.parent / "provenance.json").read_text())
    teacher, student = (record["evaluation"]["comparison"][who]["all"] for who in ("teacher", "student"))
    assert student["return"] >= 0.95 * teacher["return"]
    assert student["survived"] >= teacher["survived"] - 0.03
    assert record["minutes"] <= 10.0


def test_it_walks(bundle: Path, tmp_path: Path) -> None:
    summary = deploy.run(bundle, (0.5, 0.0, 0.0), 8.0, log=tmp_path / "walk.mcap")
    assert summary.completed, summary.reason
    assert summary.distance_m > 0.8 * 0.5 * 8.0


def test_an_unknown_student_names_what_ships() -> None:
    with pytest.raises(FileNotFoundError, match=r"'spot-blind'.*go2-blind.*codesign student"):
        shipped_bundle("spot-blind")
