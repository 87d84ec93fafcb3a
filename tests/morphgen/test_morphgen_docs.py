"""The page "bring your own robot" does what it says, on a robot as vendors write them."""

from __future__ import annotations

import re
import shlex
from importlib.metadata import entry_points
from pathlib import Path

import pytest
import robot_defects as defects
from lxml import etree

PAGE = Path(__file__).parents[2] / "docs" / "bring-your-own-robot.md"
BLOCKS = re.findall(r"^```(bash|python|console)\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def desk(tmp_path_factory) -> Path:
    """A folder with a robot that has rotors, massless links, a visual mesh and tags of its own."""
    folder = tmp_path_factory.mktemp("my_robot")
    robot = defects.clean()
    for change in ("rotors", "massless_links", "several_materials", "extra_tags", "rotated_boxes", "asymmetric"):
        defects.ALL[change](robot, folder)
    text = etree.tostring(robot, encoding="unicode").replace("package://defects_description/", "")
    (folder / "my_robot.urdf").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture
def run(desk, monkeypatch, capsys):
    """Runs a command line as the installed command would, in the folder."""
    monkeypatch.chdir(desk)
    (command,) = entry_points(group="console_scripts", name="morphgen")
    main = command.load()

    def run(line: str) -> str:
        name, *arguments = shlex.split(line)
        assert name == "morphgen"
        assert main(arguments) == 0, capsys.readouterr().err
        return capsys.readouterr().out

    return run


def test_every_kind_of_block_is_there():
    assert [kind for kind, _ in BLOCKS] == ["bash", "bash", "bash", "python", "python", "bash", "console"]


def test_the_commands_of_the_page_run(run, desk):
    lines = [line for kind, block in BLOCKS if kind == "bash" for line in block.splitlines()]
    printed = {line: run(line) for line in lines if not line.startswith("pip ")}
    assert "can be scaled" in printed["morphgen inspect my_robot.urdf"]
    assert re.search(r"FL .*0\.220\s+0\.270", printed["morphgen inspect longer.urdf"].replace("\n", " "))
    assert (desk / "side-by-side.png").read_bytes().startswith(b"\x89PNG")
    assert (desk / "longer.glb").read_bytes().startswith(b"glTF")
    assert {"designs.csv", "sheet.png"} <= {path.name for path in (desk / "bodies").iterdir()}
    assert any(path.suffix == ".urdf" for path in (desk / "longer").iterdir())


def test_the_python_of_the_page_runs(desk, monkeypatch, capsys):
    monkeypatch.chdir(desk)
    exec("\n".join(block for kind, block in BLOCKS if kind == "python"), {})
    assert capsys.readouterr().out.splitlines()[-1] == "[ True] 18"


def test_the_remedies_of_the_page_are_options(capsys):
    (command,) = entry_points(group="console_scripts", name="morphgen")
    main = command.load()
    options = ""
    for name in ("inspect", "scale"):
        with pytest.raises(SystemExit):
            main([name, "--help"])
        options += capsys.readouterr().out
    named = set(re.findall(r"`(--[a-z-]+)", PAGE.read_text(encoding="utf-8")))
    assert {"--mesh-path", "--repair", "--lock", "--hips", "--torque-limit", "--rule", "--set", "--json"} <= named
    assert [option for option in named if option not in options] == []
