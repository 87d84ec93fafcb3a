"""The command: providers by entry point, and errors of one line."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import pytest
import torch
from distill import DistillError, cli, export_bundle, providers
from distill.cli import parse_options


@pytest.fixture
def command(monkeypatch, capsys):
    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["distill", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.fixture
def install(monkeypatch):
    """Pretend that a package with these entry points is installed, and nothing else."""

    def register(**groups: dict[str, object]) -> None:
        module = SimpleNamespace()
        found = {"legged.envs": [], "legged.teachers": []}
        for group, entries in groups.items():
            for name, thing in entries.items():
                attribute = f"{group}_{name}"
                setattr(module, attribute, thing)
                entry = EntryPoint(name, f"toy_provider:{attribute}", f"legged.{group}")
                found[f"legged.{group}"].append(entry)
        monkeypatch.setitem(sys.modules, "toy_provider", module)
        monkeypatch.setattr(providers, "entry_points", lambda group: found[group])

    return register


def test_without_provider_it_says_what_to_install(command, install, tmp_path):
    install()
    code, _, err = command("train", "--env", "toy", "--teacher", "t.pt", "--out", tmp_path / "run")
    assert code == 1
    assert "pip install legged-locorl" in err
    assert "legged.envs" in err
    assert not (tmp_path / "run").exists()


def test_an_unknown_name_lists_what_there_is(command, install, make_env):
    install(envs={"toy": make_env}, teachers={"a": None, "b": None})
    code, _, err = command("train", "--env", "mars", "--teacher", "t.pt", "--out", "run")
    assert (code, "'mars'; installed: toy" in err) == (1, True)
    code, _, err = command("train", "--env", "toy", "--teacher", "t.pt", "--out", "run")
    assert (code, "choose one of: a, b" in err) == (1, True)


def test_a_provider_that_cannot_be_imported_is_named(command, install, monkeypatch):
    install()
    broken = EntryPoint("toy", "no_such_module_anywhere:make", "legged.envs")
    monkeypatch.setattr(providers, "entry_points", lambda group: [broken])
    code, _, err = command("train", "--env", "toy", "--teacher", "t.pt", "--out", "run")
    assert (code, "no_such_module_anywhere" in err) == (1, True)


def test_a_refused_option_and_a_missing_teacher_are_one_line(command, install, make_env, tmp_path):
    def loader(path):
        raise FileNotFoundError(f"{path} is not there")

    install(envs={"toy": make_env}, teachers={"toy": loader})
    base = ("train", "--env", "toy", "--teacher", "t.pt", "--out", tmp_path / "run")
    code, _, err = command(*base, "--option", "legs=6")
    assert (code, len(err.splitlines()), "legs" in err) == (1, 1, True)
    code, _, err = command(*base)
    assert (code, len(err.splitlines()), "t.pt is not there" in err) == (1, 1, True)


def test_it_trains_and_compares(command, install, make_env, teacher, tmp_path):
    paths = []
    install(envs={"toy": make_env}, teachers={"toy": lambda path: paths.append(path) or teacher})
    arguments = (
        *("train", "--env", "toy", "--teacher", tmp_path / "teacher.pt", "--out", tmp_path / "run"),
        *("--option", "num_envs=16", "--eval-steps", 20, "--train.iterations", 2, "--train.updates", 2),
        *("--train.batch", 32, "--train.rollout-steps", 4),
    )
    code, out, err = command(*arguments)
    assert code == 0, err
    assert paths == [tmp_path / "teacher.pt"]
    assert "student" in out
    assert "100.0 %" in out
    assert {path.name for path in (tmp_path / "run").iterdir()} == {"checkpoint.pt", "student.pt", "metrics.jsonl"}
    saved = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)
    assert (saved["num_envs"], saved["iteration"]) == (16, 2)


def test_verify_reports_a_bundle_and_its_faults(command, spec, student, tmp_path):
    folder = export_bundle(tmp_path / "bundle", student, spec)
    code, out, _ = command("verify", folder)
    assert (code, "6 hashes are right" in out, "policy.onnx" in out) == (0, True, True)
    (folder / "scene.xml").write_text("<mujoco/>")
    code, _, err = command("verify", folder)
    assert (code, "scene.xml: altered" in err) == (1, True)


def test_options_are_read_as_json_where_they_are():
    options = ("num_envs=64", "robot=go2", "design=[1, 1.2]", "flag=true", "text=a=b")
    assert parse_options(options) == {
        "num_envs": 64,
        "robot": "go2",
        "design": [1, 1.2],
        "flag": True,
        "text": "a=b",
    }
    with pytest.raises(DistillError, match="key=value"):
        parse_options(("fast",))
