"""A run is a folder: where it keeps what, and the configuration that it belongs to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from locorl.config import differences, from_dict, to_dict

from legged_codesign.config import RunConfig
from legged_codesign.provenance import provenance
from legged_codesign.stages import RunError, write_text


@dataclass(frozen=True)
class Files:
    """Where a run keeps what."""

    folder: Path

    @property
    def generalist(self) -> Path:
        """Pre-trained policy."""
        return self.folder / "pretrain" / "policy.pt"

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
    def bundle(self) -> Path:
        """The student, exported."""
        return self.folder / "bundle"

    @property
    def log(self) -> Path:
        """Log of the student's run."""
        return self.folder / "rollout.mcap"

    @property
    def report(self) -> Path:
        """The page to read."""
        return self.folder / "report.html"


def bind(folder: Path, config: RunConfig) -> None:
    """Write config.yaml before anything starts, or make sure that the folder is this run's.

    Raises:
        RunError: the folder holds another run, or its configuration is damaged.
    """
    path = folder / "config.yaml"
    mine = to_dict(config)
    if path.exists():
        theirs = _stored_config(path)
        changes = differences(theirs, mine)
        if changes:
            raise RunError(
                f"{folder} holds a run with another configuration; choose another --folder or delete it.\n  "
                + "\n  ".join(changes)
            )
        return
    write_text(path, yaml.safe_dump({"config": mine, "provenance": provenance()}, sort_keys=False))


def read_config(folder: Path) -> RunConfig:
    """The configuration of a run folder.

    Raises:
        RunError: the folder holds no run, or its configuration is damaged.
    """
    path = folder / "config.yaml"
    if not path.is_file():
        raise RunError(f"{folder} holds no run: {path} is missing")
    return from_dict(RunConfig, _stored_config(path))


def _stored_config(path: Path) -> Mapping[str, Any]:
    try:
        config = yaml.safe_load(path.read_text(encoding="utf-8"))["config"]
        if not isinstance(config, Mapping):
            raise TypeError("no settings under 'config'")
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
        raise RunError(f"{path} is damaged ({error}); restore it or choose another --folder") from error
    return config
