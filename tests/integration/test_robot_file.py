"""A robot given as the path of a URDF: name of the run, binding of the folder, errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import locorl.providers
import numpy as np
import pytest
import yaml
from morphgen import BodyFactory
from rich.console import Console

from legged_codesign import RunConfig, pipeline
from legged_codesign.commands.run import Run
from legged_codesign.robots import body_factory
from legged_codesign.run_folder import bind, read_config
from legged_codesign.stages import RunError

Codesign = Callable[..., tuple[int, str]]


class Opener:
    """The entry point that opens URDFs."""

    name = "urdf"

    def load(self) -> Callable[[Path], BodyFactory]:
        return lambda path: BodyFactory(path.stem, path.read_text(), source=str(path))


@pytest.fixture
def robot(go2: BodyFactory, design: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A relative path, seen from the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(locorl.providers, "entry_points", lambda group: [Opener()])
    Path("mine").mkdir()
    Path("mine/wolf.urdf").write_text(go2.urdf(design))
    return "mine/wolf.urdf"


def test_the_run_is_named_after_the_file(robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started = []

    def run(config: RunConfig, folder: Path, *_: object) -> None:
        started.append((config, folder))
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "run", run)
    for name in (robot, "go2"):
        with pytest.raises(KeyboardInterrupt):
            Run(preset="smoke", robot=name).run(Console())
    (mine, folder), (builtin, default) = started
    assert folder == Path("runs/smoke-wolf-flat-cost-of-transport")
    assert mine.robot == str(tmp_path / "mine/wolf.urdf")
    assert (builtin.robot, default) == ("go2", Path("runs/smoke-go2-flat-cost-of-transport"))


def test_the_factory_is_named_after_the_file(robot: str) -> None:
    assert body_factory(robot).name == "wolf"


def test_a_changed_file_does_not_continue_a_run(robot: str, tmp_path: Path) -> None:
    config = Run(preset="smoke", robot=robot).config()
    bind(tmp_path / "run", config)
    bind(tmp_path / "run", config)
    assert read_config(tmp_path / "run") == config
    Path(robot).write_text(Path(robot).read_text().replace("<robot", "<!-- longer --><robot"))
    for use in (lambda: bind(tmp_path / "run", config), lambda: read_config(tmp_path / "run")):
        with pytest.raises(RunError, match=r"wolf\.urdf has changed since the run in .* began; restore it or choose"):
            use()


def test_a_folder_from_before_robot_files_still_opens(tmp_path: Path) -> None:
    config = Run(preset="smoke").config()
    bind(tmp_path, config)
    path = tmp_path / "config.yaml"
    content = yaml.safe_load(path.read_text())
    del content["robot_sha256"]
    path.write_text(yaml.safe_dump(content))
    assert read_config(tmp_path) == config


def test_errors(robot: str, codesign: Codesign, monkeypatch: pytest.MonkeyPatch) -> None:
    """A missing file, no generalist to start from, no package to open it; nothing is left behind."""
    cases = [("mine/fox.urdf", "no robot file"), (robot, "--from-scratch")]
    for name, words in cases:
        code, output = codesign("run", "--preset", "laptop", "--robot", name)
        assert code == 1, output
        assert words in output
        assert Path(name).name in output
    monkeypatch.setattr(locorl.providers, "entry_points", lambda group: [])
    code, output = codesign("run", "--preset", "laptop", "--robot", robot)
    assert code == 1
    assert "pip install legged-morphgen" in output
    assert not Path("runs").exists()
