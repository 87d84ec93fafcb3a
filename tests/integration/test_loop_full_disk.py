"""A disk that is full in any stage of a run: words, nothing lost, and the same result once there is room."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from legged_codesign.stages import forget

pytestmark = pytest.mark.slow

OUTPUTS = {
    "pretrain": "pretrain/generalist.pt",
    "screen": "screening.json",
    "search": "trials.json",
    "confirm": "choice.json",
    "distil": "student/student/student.pt",
    "compare": "student/comparison.json",
    "export": "bundle/manifest.json",
    "deploy": "rollout.json",
    "report": "report.html",
}
"""What each stage leaves behind; without it the stage is done again."""


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A disk of its own of 200 MB."""
    place = tmp_path_factory.mktemp("disk")
    mount = ["mount", "-t", "tmpfs", "-o", "size=200m", "tmpfs", str(place)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("needs to mount a disk: run as root")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)


def fill(disk: Path, left: int) -> Path:
    """Fill a disk up to `left` bytes; returns the file that does."""
    filler = disk / "filler"
    room = os.statvfs(disk)
    with filler.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, room.f_bavail * room.f_frsize - left)
    return filler


@pytest.mark.parametrize("left", [0, 40960], ids=["none", "40kB"])
@pytest.mark.parametrize("stage", OUTPUTS)
def test_a_full_disk_loses_nothing(stage: str, left: int, disk: Path, finished, run_smoke: Callable) -> None:
    folder = disk / f"{stage}-{left}"
    shutil.copytree(finished.folder, folder)
    (folder / OUTPUTS[stage]).unlink()
    forget(folder, stage)
    if stage == "export":
        shutil.rmtree(folder / "bundle")
    if stage == "search":
        (folder / "study.sqlite").unlink()
        shutil.rmtree(folder / "trials")
    filler = fill(disk, left)
    try:
        full = run_smoke(folder)
    finally:
        filler.unlink()
    if full.code:  # what is small enough for the room that was left is written
        assert full.code == 1, full.output
        assert "Traceback" not in full.output
        assert f"the disk of {folder} is full: make room, and the same command goes on" in full.output
    else:
        assert left, full.output
    resumed = run_smoke(folder)
    assert resumed.code == 0, resumed.output
    for name in ("trials.json", "choice.json", "best.urdf"):
        assert (folder / name).read_text() == (finished.folder / name).read_text(), name
    assert (folder / OUTPUTS[stage]).exists()
    shutil.rmtree(folder)
