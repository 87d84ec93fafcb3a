"""The command `locorl`, through `main()`."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from urllib.request import urlopen

import locorl.cli
import locorl.providers
import numpy as np
import pytest
from locorl import load_policy, make_task
from locorl.play.errors import PlayError
from locorl.play.renderer import gl_context
from locorl_box import BoxQuadruped

NETWORK = ["--network.actor", "16", "--network.critic", "16", "--network.encoder", "8", "--network.latent", "4"]
PPO = ["--ppo.steps", "6", "--ppo.epochs", "1", "--ppo.minibatches", "2"]
TRAIN = ["--robot", "box", "--num-envs", "8", *PPO, *NETWORK]


class EntryPoint:
    """Stands in for an installed package that makes a robot."""

    def __init__(self, name: str = "box") -> None:
        self.name = name

    def load(self):
        return lambda: BoxQuadruped(self.name)


def install(monkeypatch: pytest.MonkeyPatch, *points: object) -> None:
    monkeypatch.setattr(locorl.providers, "entry_points", lambda group: points if group == "legged.bodies" else [])


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    install(monkeypatch, EntryPoint("box"), EntryPoint("crate"))
    monkeypatch.setattr(sys, "argv", ["locorl", *map(str, arguments)])
    locorl.cli.main()


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        run(patch, "train", folder, "--iterations", 2, *TRAIN)
    return folder


def test_help_lists_the_commands(monkeypatch, capsys):
    with pytest.raises(SystemExit, match="0"):
        run(monkeypatch, "--help")
    text = capsys.readouterr().out
    assert all(command in text for command in ("train", "finetune", "evaluate", "play", "terrain"))


def test_train_and_resume(monkeypatch, capsys, trained):
    assert load_policy(trained / "policy.pt").card.samples == 2 * 48
    run(monkeypatch, "train", trained, "--iterations", 3, *TRAIN)
    assert load_policy(trained / "policy.pt").card.samples == 3 * 48
    out = capsys.readouterr().out
    assert "8 robots x 6 steps x 3 iterations" in out


def test_train_takes_a_task_by_name(monkeypatch, tmp_path):
    run(monkeypatch, "train", tmp_path, "--iterations", 1, "--task", "parkour-stones", "--preset", "paper", *TRAIN)
    assert load_policy(tmp_path / "policy.pt").card.task == make_task("parkour-stones", "paper")


def test_evaluate_prints_json(monkeypatch, capsys, trained):
    protocol = ["--evaluation.seconds", 0.4, "--evaluation.settle", 0.1, "--robot", "box"]
    run(monkeypatch, "evaluate", trained / "policy.pt", "--bodies", 3, "--json", *protocol)

    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not JSON")

    result = json.loads(capsys.readouterr().out, parse_constant=refuse)
    assert result["summary"]["robots"] == len(result["robots"]) == 3
    assert result["protocol"]["seconds"] == 0.4
    mean = np.mean([row["tracking_error"] for row in result["robots"]])
    assert result["summary"]["tracking_error"] == pytest.approx(mean)
    assert all(len(row["design"]) == 4 for row in result["robots"])
    assert result["summary"]["cost_of_transport"] is None  # in 0.4 s nobody gets anywhere


def test_evaluate_one_design_as_a_table(monkeypatch, capsys, trained):
    protocol = ["--evaluation.seconds", 0.4, "--evaluation.settle", 0.1, "--robot", "box"]
    run(monkeypatch, "evaluate", trained / "policy.pt", "--design", 1, 1, 1, 1, *protocol)
    out = capsys.readouterr().out
    assert "policy.pt" in out
    assert "tracking error" in out


def test_finetune_prints_both_policies(monkeypatch, capsys, trained, tmp_path):
    budget = ["--config.num-envs", 8, "--config.iterations", 1, "--config.ppo.steps", 4]
    score = ["--evaluation.seconds", 0.4, "--evaluation.settle", 0.1, "--evaluation.robots-per-body", 2]
    body = ["--robot", "box", "--design", 1, 1.2, 1, 1]
    run(monkeypatch, "finetune", trained / "policy.pt", tmp_path, *body, *budget, *score)
    out = capsys.readouterr().out
    assert "generalist" in out
    assert "fine-tuned" in out
    assert load_policy(tmp_path / "policy.pt").card.robot == "box"


def test_play_writes_a_video_and_prints_the_score(monkeypatch, capsys, trained, tmp_path):
    imageio = pytest.importorskip("imageio.v3")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    try:
        gl_context(64, 64).free()
    except PlayError as error:
        pytest.skip(str(error))
    film = ["-o", tmp_path / "out.mp4", "--seconds", 0.1, "--size", 96, 64]
    run(monkeypatch, "play", "--robot", "box", "--policy", trained / "policy.pt", "--command", 0.5, 0, 0, *film)
    assert imageio.imread(tmp_path / "out.mp4").shape == (5, 64, 96, 3)
    out = capsys.readouterr().out
    assert "locomotion-flat" in out
    assert all(word in out for word in ("survived", "distance", "speed"))
    run(monkeypatch, "play", "--robot", "box", "--task", "parkour-stones", "--level", 9, "--bodies", 2, *film)
    assert "parkour-stones" in capsys.readouterr().out


def test_play_serves_a_page_until_it_is_stopped(monkeypatch, capsys):
    browser = pytest.importorskip("locorl.play.browser")
    served = []

    def stop(page) -> None:
        with urlopen(f"http://127.0.0.1:{page.server.get_port()}") as answer:
            served.append(answer.status)
        raise KeyboardInterrupt

    monkeypatch.setattr(browser.Page, "run", stop)
    run(monkeypatch, "play", "--robot", "box", "--task", "locomotion-steps", "--no-open", "--port", 0)
    assert served == [200]
    assert re.fullmatch(r"locomotion-steps, box: http://localhost:\d+ \(Ctrl-C ends\)\n", capsys.readouterr().out)


def test_play_without_its_extra_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(SystemExit, match="1"):
        run(monkeypatch, "play", "--robot", "box")
    assert "viser: pip install 'legged-locorl[play]'" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["play", "--robot", "box", "--task", "dance"], "there is no task 'dance'"),
        (["play", "--robot", "box", "--policy", "wave"], "no policy 'wave'"),
        (["play", "--robot", "box", "--design", 1, 1], "has 4 parameters"),
        (["play", "--robot", "box", "--task", "locomotion-hills", "--level", 10], "levels 0 to 4, got 10"),
        (["play", "--robot", "crate", "--policy", "{run}/policy.pt"], "cannot control 'crate'"),
        (["play", "--robot", "box", "-o", "out.gif"], "a video is an .mp4 file"),
        (["evaluate", "nowhere.pt", "--robot", "box"], "no checkpoint at nowhere.pt"),
        (["evaluate", "{run}/policy.pt", "--robot", "box", "--bodies", 0], "at least one body, got 0"),
        (["evaluate", "{run}/policy.pt", "--robot", "box", "--grid", 0], "at least one value per parameter"),
        (["train", "{run}/x", "--task", "dance", *TRAIN], "there is no task 'dance'"),
        (["train", "{run}/x", "--task", "parkour-stones", "--task.action-scale", 0.5, *TRAIN], "give either"),
        (["train", "{run}", "--iterations", 2, "--seed", 5, *TRAIN], "seed: 0 -> 5"),
        (["evaluate", "{run}/policy.pt", "--robot", "crate"], "cannot control 'crate'"),
        (["finetune", "{run}/policy.pt", "{run}/x", "--design", 2, 1, 1, 1, "--robot", "box"], "front_thigh=2 not in"),
    ],
)
def test_errors_are_one_message_and_a_status(monkeypatch, capsys, trained, arguments, message):
    with pytest.raises(SystemExit, match="1"):
        run(monkeypatch, *(str(argument).replace("{run}", str(trained)) for argument in arguments))
    out = " ".join(capsys.readouterr().out.split())
    assert "error:" in out
    assert message in out


@pytest.mark.parametrize(("installed", "known"), [([], "none"), ([EntryPoint()], "box")])
def test_an_unknown_robot_names_the_package_to_install(monkeypatch, installed, known):
    install(monkeypatch, *installed)
    message = rf"no robot 'wolf' \(installed: {known}\).*pip install legged-morphgen"
    with pytest.raises(LookupError, match=message):
        locorl.providers.find_factory("wolf")


class Opener:
    """Stands in for the package that opens URDFs: the robot is named after the file."""

    name = "urdf"

    def load(self):
        def open_file(path: Path) -> BoxQuadruped:
            assert path.read_text() == "<robot/>"
            return BoxQuadruped(path.stem)

        return open_file


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "wolf.urdf"
    path.write_text("<robot/>")
    return path


def test_a_path_is_opened_by_the_entry_point_urdf(monkeypatch, file):
    install(monkeypatch, EntryPoint(), Opener())
    assert locorl.providers.find_factory(str(file)).name == "wolf"
    assert locorl.providers.find_factory("box").name == "box"
    with pytest.raises(FileNotFoundError, match=r"no robot file 'nowhere/wolf\.URDF'"):
        locorl.providers.find_factory("nowhere/wolf.URDF")
    with pytest.raises(LookupError, match=r"no robot 'urdf' \(installed: box\)"):
        locorl.providers.find_factory("urdf")


def test_a_path_without_an_opener_names_the_package_to_install(monkeypatch, file):
    install(monkeypatch, EntryPoint())
    with pytest.raises(LookupError, match=r"opens '.*wolf\.urdf'.*pip install legged-morphgen"):
        locorl.providers.find_factory(str(file))


def test_providers_find_robots_by_entry_point(monkeypatch, trained):
    install(monkeypatch, EntryPoint())
    one = locorl.providers.make_env("box", num_envs=2, design=(1.0, 1.2, 1.0, 1.2))
    np.testing.assert_array_equal(one.env.bodies.designs, [(1.0, 1.2, 1.0, 1.2)] * 2)
    many = locorl.providers.make_env("box", num_envs=3, seed=1)
    assert len(np.unique(many.env.bodies.designs, axis=0)) == 3
    teacher = locorl.providers.load_teacher(trained / "policy.pt")
    assert teacher.act(many.reset()).shape == (3, 12)
