"""A run is a folder: where it keeps what, and the configuration that it belongs to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import yaml
from locorl.config import differences, from_dict, to_dict

from legged_codesign.config import RunConfig
from legged_codesign.provenance import command_line, provenance
from legged_codesign.robots import file_hash
from legged_codesign.stages import RunError, write_text


@dataclass(frozen=True)
class Files:
    """Where a run keeps what."""

    folder: Path

    @property
    def training(self) -> Path:
        """Folder of the pre-training."""
        return self.folder / "pretrain"

    @property
    def generalist(self) -> Path:
        """Policy that every trial starts from, on the run's task."""
        return self.training / "generalist.pt"

    @property
    def screening(self) -> Path:
        """Zero-shot scores of the screened bodies."""
        return self.folder / "screening.json"

    @property
    def study(self) -> Path:
        """The search."""
        return self.folder / "study.sqlite"

    @property
    def trials(self) -> Path:
        """Trial table, for people and for comparisons."""
        return self.folder / "trials.json"

    @property
    def choice(self) -> Path:
        """The chosen body and its teacher."""
        return self.folder / "choice.json"

    @property
    def best_urdf(self) -> Path:
        """The chosen body."""
        return self.folder / "best.urdf"

    @property
    def teacher(self) -> Path:
        """The chosen body's policy."""
        return self.folder / "teacher.pt"

    @property
    def student(self) -> Path:
        """Everything about the student but its bundle."""
        return self.folder / "student"

    @property
    def bundle(self) -> Path:
        """The student, exported."""
        return self.folder / "bundle"

    @property
    def log(self) -> Path:
        """Log of the student's run."""
        return self.folder / "rollout.mcap"

    @property
    def rollout(self) -> Path:
        """Summary of the student's run."""
        return self.folder / "rollout.json"

    @property
    def prediction(self) -> Path:
        """What the run was predicted to take."""
        return self.folder / "stages" / "prediction.json"

    @property
    def report(self) -> Path:
        """The page to read."""
        return self.folder / "report.html"


class Bound(Protocol):
    """A configuration that begins with a robot."""

    @property
    def robot(self) -> str:
        """Name of an installed robot, or path of a URDF."""
        ...


def bind(folder: Path, config: Bound, what: str = "run") -> None:
    """Write config.yaml before anything starts, or make sure that the folder is this run's.

    Args:
        folder: of the run.
        config: all that determines it, a dataclass.
        what: the folder holds, for messages.

    Raises:
        RunError: the folder holds another run, its configuration is damaged, or the robot's file has changed.
    """
    path = folder / "config.yaml"
    mine = to_dict(config)
    if path.exists():
        stored = read_stored(folder)
        changes = differences(_completed(type(config), stored["config"]), mine)
        if changes:
            raise RunError(
                f"{folder} holds a {what} with another configuration; choose another --folder or delete it.\n  "
                + "\n  ".join(changes)
            )
        _check_robot(folder, config.robot, stored)
        return
    content = {
        "config": mine,
        "robot_sha256": file_hash(config.robot),
        "command": command_line(),
        "provenance": provenance(),
    }
    write_text(path, yaml.safe_dump(content, sort_keys=False))


def _completed(kind: type, settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """Settings as this version writes them: those that the folder's version did not know have their defaults."""
    try:
        return to_dict(from_dict(kind, settings))
    except (TypeError, ValueError):  # of a later version; the differences say which
        return settings


def read_config(folder: Path) -> RunConfig:
    """The configuration of a run folder.

    Raises:
        RunError: the folder holds no run, its configuration is damaged, or the robot's file has changed.
    """
    stored = read_stored(folder)
    config = from_dict(RunConfig, stored["config"])
    _check_robot(folder, config.robot, stored)
    return config


def _check_robot(folder: Path, robot: str, stored: Mapping[str, Any]) -> None:
    if file_hash(robot) != stored.get("robot_sha256"):
        raise RunError(f"{robot} has changed since the run in {folder} began; restore it or choose another --folder")


def read_stored(folder: Path) -> Mapping[str, Any]:
    """Content of config.yaml as it stands there: `config`, `robot_sha256`, `command`, `provenance`.

    Raises:
        RunError: the folder holds no run, or its configuration is damaged.
    """
    path = folder / "config.yaml"
    if not path.is_file():
        raise RunError(f"{folder} holds no run: {path} is missing")
    try:
        stored = yaml.safe_load(path.read_text(encoding="utf-8"))
        if not isinstance(stored["config"], Mapping):
            raise TypeError("no settings under 'config'")
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
        raise RunError(f"{path} is damaged ({error}); restore it or choose another --folder") from error
    return stored
