"""The command: providers by entry point, and errors of one line."""

from __future__ import annotations

import json
import sys
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from distill import DistillError, cli, export_bundle, load_student, load_vision_student, providers, write_spec
from distill.commands.providing import parse_options
from torch import Tensor
from vision_toy import VisionToy, VisionToyTeacher


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


def test_a_student_is_compared_with_its_teacher_by_group_and_on_film(
    command, install, make_env, teacher, plain_teacher, tmp_path
):
    class Measures(SimpleNamespace):
        tracking_error: Tensor
        success: Tensor

    class Described(make_env):
        """Even robots are "hilly", odd ones "flat"; a step's error is 1 m/s on hills; picture k is k + 1 everywhere."""

        control_dt = 0.02

        def groups(self):
            names = ["flat", "hilly"] * (self.num_envs // 2)
            return {"terrain": names, "body": ["one"] * self.num_envs}

        def step(self, action):
            obs, reward, terminated, truncated, _ = super().step(action)
            hilly = (torch.arange(self.num_envs) % 2).float()
            return obs, reward, terminated, truncated, Measures(tracking_error=hilly, success=hilly > 0)

        def picture(self, robot, width, height):
            return np.full((height, width, 3), 40 * robot, np.uint8)

    paths = []
    install(envs={"toy": Described}, teachers={"toy": lambda path: paths.append(path) or teacher})
    base = ("--env", "toy", "--teacher", "t.pt", "--option", "num_envs=8")
    small = ("--train.iterations", 1, "--train.updates", 1, "--train.batch", 8, "--train.rollout-steps", 4)
    assert command("train", *base, "--out", tmp_path, "--eval-steps", 0, *small)[0] == 0
    film, table = tmp_path / "film.mp4", tmp_path / "table.json"
    arguments = ("evaluate", *base, "--student", tmp_path / "student.pt", "--steps", 10, "--json", table)
    code, out, err = command(*arguments)
    assert code == 0, err
    assert "by terrain" in out
    assert "by body" not in out  # they are all alike
    found = json.loads(table.read_text())
    assert set(found) == {"teacher", "student"}
    for score in found.values():
        assert score["all"]["robots"] == 8
        assert score["all"]["succeeded"] == 0.5
        assert score["terrain"]["hilly"] == pytest.approx({**score["terrain"]["hilly"], "tracking_error": 1.0})
        assert (score["terrain"]["hilly"]["succeeded"], score["terrain"]["flat"]["succeeded"]) == (1.0, 0.0)
        assert score["terrain"]["flat"]["tracking_error"] == 0.0
        both = [score["terrain"][name]["return"] for name in ("flat", "hilly")]
        assert sum(both) / 2 == pytest.approx(score["all"]["return"], rel=1e-5)
    # the toy's teacher is exact from the second step on: nobody does better
    assert found["teacher"]["all"]["return"] > found["student"]["all"]["return"]
    assert found["student"]["all"]["velocity_error"] > 0.0

    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    code, out, err = command(*arguments, "--video", film, "--robot", 2)
    assert code == 0, err
    reader = imageio_ffmpeg.read_frames(str(film))
    assert next(reader)["size"] == (960, 384)  # two panes of 480 x 360 below a line with their names
    frames = [np.frombuffer(frame, np.uint8).reshape(384, 960, 3) for frame in reader]
    assert len(frames) == 5  # 10 steps of 20 ms at 25 frames/s
    assert abs(int(frames[0][200, 100, 0]) - 80) < 6
    assert json.loads(table.read_text()) == found  # filming changes nothing
    code, _, err = command(*arguments, "--video", film, "--robot", 8)
    assert (code, "no robot 8 of 8" in err) == (1, True)

    install(envs={"toy": make_env}, teachers={"toy": lambda path: teacher})
    code, _, err = command(*arguments, "--video", film)
    assert (code, "draws no pictures" in err) == (1, True)


VISION = (
    *("--option", "num_envs=8", "episode=12", "--eval-steps", 5, "--vision.iterations", 1, "--vision.updates", 1),
    *("--vision.rollout-steps", 10, "--vision.batch", 8, "--vision-student.depth.image-hidden", 8),
)


class SharpToy(VisionToy):
    """Images of the size that the default encoder is made for."""

    def __init__(self, *args, **options) -> None:
        super().__init__(*args, **options)
        self.depth_shape = (24, 36)

    def look(self) -> Tensor:
        return super().look().repeat_interleave(3, dim=1).repeat_interleave(3, dim=2)


def test_a_seeing_student_is_trained_with_its_ablations(command, install, tmp_path):
    install(envs={"toy": SharpToy}, teachers={"toy": lambda path: VisionToyTeacher()})
    base = ("train", "--env", "toy", "--teacher", "t.pt", *VISION, "--seeing")
    code, out, err = command(*base, "--out", tmp_path / "a", "--no-roa", "--no-mts", "--blind", "--latent-supervision")
    assert code == 0, err
    assert "student" in out
    saved = torch.load(tmp_path / "a" / "checkpoint.pt", weights_only=True)
    ablations = {name: saved["config"][name] for name in ("mts", "roa", "latent_supervision")}
    assert ablations == {"mts": False, "roa": False, "latent_supervision": True}
    assert load_vision_student(tmp_path / "a" / "student.pt", VisionToyTeacher()).config.blind
    (row,) = [json.loads(line) for line in (tmp_path / "a" / "metrics.jsonl").read_text().splitlines()]
    assert row["predicted_use"] == 1.0
    assert row["terrain_loss"] > 0.0

    code, out, err = command(
        *("evaluate", "--env", "toy", "--teacher", "t.pt", "--option", "num_envs=8"),
        *("--student", tmp_path / "a" / "student.pt", "--steps", 5),
    )
    assert code == 0, err
    assert "student" in out


def test_options_that_would_do_nothing_and_missing_parts_are_refused(command, install, make_env, teacher, tmp_path):
    install(envs={"toy": make_env, "sighted": VisionToy}, teachers={"toy": lambda path: teacher})
    base = ("train", "--teacher", "t.pt", "--out", tmp_path / "run")
    code, _, err = command(*base, "--env", "toy", "--no-mts", "--blind")
    assert (code, "--no-mts, --blind: only a seeing student has that; add --seeing" in err) == (1, True)
    code, _, err = command(*base, "--env", "sighted", "--seeing")
    assert (code, "--adaptation FILE" in err) == (1, True)
    code, _, err = command(*base, "--env", "sighted", "--seeing", "--no-roa", "--adaptation", "a.pt")
    assert (code, "not read without ROA" in err) == (1, True)
    code, _, err = command(*base, "--env", "toy", "--seeing", "--no-roa")
    assert (code, "'toy' has no heading, depth_shape, depth_period:" in err) == (1, True)
    code, _, err = command(*base, "--env", "sighted", "--seeing", "--no-roa", "--vision.updates", 0)
    assert (code, "updates is 0" in err) == (2, True)
    assert not (tmp_path / "run").exists()


def test_export_writes_a_bundle_from_files(command, install, make_env, plain_teacher, spec, tmp_path):
    install(envs={"toy": make_env}, teachers={"toy": lambda path: plain_teacher})
    small = ("--train.iterations", 1, "--train.updates", 1, "--train.batch", 8, "--train.rollout-steps", 4)
    base = ("--env", "toy", "--teacher", "t.pt", "--out", tmp_path / "run", "--eval-steps", 0)
    assert command("train", *base, "--option", "num_envs=8", *small)[0] == 0
    write_spec(spec, tmp_path / "spec.json")
    arguments = ("--student", tmp_path / "run" / "student.pt", "--teacher", "t.pt", "--out", tmp_path / "bundle")
    code, _, err = command("export", *arguments, "--spec", tmp_path / "spec.json")
    # the toy's students read 36 columns, this robot has 48
    assert (code, "the observation terms add up to" in err) == (1, True)
    assert load_student(tmp_path / "run" / "student.pt", plain_teacher).proprio == 36
    table = json.loads((tmp_path / "spec.json").read_text())
    table["observation"] = [term for term in table["observation"] if term["name"] in ("joints", "rates", "action")]
    (tmp_path / "spec.json").write_text(json.dumps(table))
    code, out, err = command("export", *arguments, "--spec", tmp_path / "spec.json")
    assert code == 0, err
    assert "distill inspect" in out
    code, out, _ = command("verify", tmp_path / "bundle")
    assert (code, "policy.ts.pt" in out) == (0, True)


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
