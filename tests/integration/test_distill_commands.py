"""`distill` with locorl's robots and teachers, found by the entry points that locorl's pyproject declares."""

from __future__ import annotations

import json
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from distill import InterfaceError, cli, providers
from distill.interfaces import FilmedEnv, GroupedEnv, check_env, check_teacher

from legged_codesign.pretrained import shipped

PROJECT = Path(__file__).parents[2] / "packages/locorl/pyproject.toml"
TINY = (
    *("--train.iterations", "1", "--train.updates", "1", "--train.batch", "16", "--train.rollout-steps", "4"),
    *("--vision.iterations", "1", "--vision.updates", "1", "--vision.batch", "4", "--vision.rollout-steps", "5"),
    *("--eval-steps", "0"),
)


@pytest.fixture(autouse=True)
def declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """The entry points of the checkout, whatever an older installation says."""
    groups = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["entry-points"]

    def entry_points(group: str) -> list[EntryPoint]:
        return [EntryPoint(name, value, group) for name, value in groups.get(group, {}).items()]

    monkeypatch.setattr(providers, "entry_points", entry_points)


def distill(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["distill", *map(str, arguments)])
    cli.main()


def test_the_example_of_the_readme_finds_its_robots() -> None:
    env = providers.make_env("locomotion", {"robot": "go2", "num_envs": 4})
    check_env(env)
    assert env.num_envs == 4
    assert isinstance(env, GroupedEnv)
    assert isinstance(env, FilmedEnv)
    teacher = providers.load_teacher(shipped("go2-flat"))
    assert teacher.act(env.reset(seed=1)).shape == (4, 12)


@pytest.mark.slow
def test_a_blind_and_a_seeing_student_by_command_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys) -> None:
    teacher = shipped("lite3-parkour")
    ground = ("num_envs=4", f"policy={teacher}", 'terrain=["hurdles"]')
    for env, kind in (("parkour", ()), ("parkour-depth", ("--seeing", "--no-roa"))):
        out = tmp_path / env
        base = ("--env", env, "--teacher", teacher, "--option", *ground)
        distill(monkeypatch, "train", *base, "--out", out, *TINY, *kind)
        table = tmp_path / f"{env}.json"
        student = ("--student", out / "student.pt", "--steps", 5, "--json", table)
        distill(monkeypatch, "evaluate", *base, *student)
        found = json.loads(table.read_text())
        assert set(found["student"]["terrain"]) == {"hurdles"}
        assert found["teacher"]["all"]["robots"] == 4
        assert "tracking_error" in found["student"]["all"]
    with pytest.raises(SystemExit):
        distill(monkeypatch, "evaluate", "--env", "parkour", "--teacher", teacher, "--option", *ground, *student)
    assert "'parkour' has no" in capsys.readouterr().err


def test_a_teacher_of_another_robot_rate_or_observation_is_refused() -> None:
    teacher = providers.load_teacher(shipped("go2-flat"))
    check_teacher(providers.make_env("locomotion", {"num_envs": 2}), teacher)
    for options, message in (
        ({"robot": "lite3"}, "robot: go2 in its training, lite3 here"),
        ({"preset": "paper"}, "proprioception: .* in its training"),
        ({"task": "locomotion-rough"}, "scan: None in its training, ScanConfig"),
    ):
        with pytest.raises(InterfaceError, match=message):
            check_teacher(providers.make_env("locomotion", {"num_envs": 2, **options}), teacher)
