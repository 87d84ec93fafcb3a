"""The students that ship: intact, as good as their provenance says, and on their feet in deploy's simulation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import deploy
import pytest
from distill import load_student, load_vision_student, verify_bundle
from locorl import load_policy
from rosbags.highlevel import AnyReader

from legged_codesign.pretrained import shipped_bundle

STUDENTS = ("go2-blind", "lite3-depth")


@pytest.fixture(scope="module", params=STUDENTS)
def bundle(request: pytest.FixtureRequest) -> Path:
    return shipped_bundle(request.param)


def test_the_bundle_is_intact(bundle: Path) -> None:
    assert max(verify_bundle(bundle).errors.values()) <= 1e-5


def test_it_is_small(bundle: Path) -> None:
    assert sum(path.stat().st_size for path in bundle.parent.rglob("*") if path.is_file()) < 10_000_000


def test_student_and_teacher_lie_beside_it(bundle: Path) -> None:
    manifest = json.loads((bundle / "manifest.json").read_text())
    teacher = load_policy(bundle.parent / "teacher.pt")
    assert teacher.card.robot == manifest["robot"]["name"]
    load = load_vision_student if manifest.get("depth") else load_student
    load(bundle.parent / "student.pt", teacher)


def test_the_blind_one_keeps_its_teachers_return() -> None:
    record, (teacher, student) = recorded("go2-blind")
    assert student["return"] >= 0.95 * teacher["return"]
    assert student["survived"] >= teacher["survived"] - 0.03
    assert record["minutes"] <= 10.0


def test_the_seeing_one_keeps_its_teachers_success() -> None:
    record, (teacher, student) = recorded("lite3-depth")
    assert student["succeeded"] >= 0.85 * teacher["succeeded"]
    assert record["minutes"] <= 60.0


def recorded(name: str) -> tuple[dict[str, Any], list[dict[str, float]]]:
    """Provenance, and the means of teacher and student over all robots."""
    record = json.loads((shipped_bundle(name).parent / "provenance.json").read_text())
    return record, [record["evaluation"]["comparison"][who]["all"] for who in ("teacher", "student")]


@pytest.mark.parametrize(("name", "speed"), [("go2-blind", 0.5), ("lite3-depth", 0.95)])
def test_it_walks_and_its_log_is_replayed_to_the_bit(name: str, speed: float, tmp_path: Path) -> None:
    log = tmp_path / "walk.mcap"
    summary = deploy.run(shipped_bundle(name), (speed, 0.0, 0.0), 8.0, log=log)
    assert summary.completed, summary.reason
    assert summary.distance_m > 0.8 * speed * 8.0
    bundle = deploy.load_bundle(shipped_bundle(name))
    result = deploy.replay(log, bundle, deploy.OnnxRuntime(bundle))
    assert result.ticks >= 400
    assert result.first is None
    with AnyReader([log]) as reader:
        messages = {connection.topic: connection.msgcount for connection in reader.connections}
    assert messages["/policy/action"] == result.ticks


def test_an_unknown_student_names_what_ships() -> None:
    with pytest.raises(FileNotFoundError, match=r"'spot-blind'.*go2-blind.*lite3-depth.*codesign student"):
        shipped_bundle("spot-blind")
