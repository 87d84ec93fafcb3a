"""What the report shows, read from a run folder alone; what is not there yet is empty or None."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import codesign_bo
from codesign_bo.confirm import Gain
from codesign_bo.records import ConfirmationRecord, TrialRecord
from deploy import LogError
from deploy.logs.reading import Log, read_log
from locorl.training.metrics import read_metrics

from legged_codesign.choice import Choice
from legged_codesign.run_folder import Files, read_stored
from legged_codesign.stages import RunError


@dataclass(frozen=True)
class RunData:
    """A run, finished or not.

    Attributes:
        folder: of the run.
        settings: its configuration, as it stands in config.yaml.
        command: that started it; empty for a run of an earlier version.
        provenance: versions, machine and commit.
        trials: the search, by number.
        confirmations: the runs on fresh seeds.
        gains: each confirmed body against the nominal one.
        choice: the body that the run settled on; None before the confirmation.
        screening: of each screened body, the nominal one first: parameters, score, how many robots came through, and
            tracking error.
        pretrain: metrics of the pre-training; empty if the generalist was shipped.
        comparison: means of student and teacher on the same starts; survival is a share.
        rollout: summary of the student's run; None before it.
        log: its log; None if it cannot be read.
        log_problem: why not.
        stages: seconds of each stage.
    """

    folder: Path
    settings: Mapping[str, Any]
    command: str
    provenance: Mapping[str, str]
    trials: Sequence[TrialRecord]
    confirmations: Sequence[ConfirmationRecord]
    gains: Sequence[Gain]
    choice: Choice | None
    screening: Sequence[Mapping[str, Any]]
    pretrain: Sequence[Mapping[str, float]]
    comparison: Mapping[str, Mapping[str, float]]
    rollout: Mapping[str, Any] | None
    log: Log | None
    log_problem: str
    stages: Mapping[str, float]

    @property
    def nominal(self) -> Mapping[str, float]:
        """Parameters of the run's nominal body; empty before the search."""
        return {name: float(value) for name, value in self.trials[0].params.items()} if self.trials else {}


def read_run(folder: Path) -> RunData:
    """Read everything that the report shows.

    Raises:
        RunError: the folder holds no run, or a file in it is damaged.
    """
    files, stored = Files(folder), read_stored(folder)
    trials: Sequence[TrialRecord] = ()
    confirmations: Sequence[ConfirmationRecord] = ()
    gains: Sequence[Gain] = ()
    if files.study.is_file():
        with codesign_bo.open_study(files.study) as view:
            trials, confirmations, gains = view.trials(), view.confirmations(), view.confirmation().gains
    choice = _json(files.choice)
    log, problem = _log(files.log)
    return RunData(
        folder=folder,
        settings=stored["config"],
        command=stored.get("command", ""),
        provenance=stored.get("provenance", {}),
        trials=trials,
        confirmations=confirmations,
        gains=gains,
        choice=None if choice is None else Choice(**choice),
        screening=_json(files.screening) or (),
        pretrain=read_metrics(files.training / "metrics.jsonl"),
        comparison=_comparison(_json(files.student / "comparison.json")),
        rollout=_json(files.rollout),
        log=log,
        log_problem=problem,
        stages=_stages(folder / "metrics.jsonl"),
    )


def _log(path: Path) -> tuple[Log | None, str]:
    if not path.is_file():
        return None, f"there is no {path.name} yet: the student has not run"
    try:
        return read_log(path), ""
    except LogError as error:
        return None, str(error)


def _comparison(stored: Any) -> dict[str, Mapping[str, float]]:
    """Means over all robots, by policy."""
    return {name: row["all"] for name, row in stored["means"].items()} if stored else {}


def _stages(path: Path) -> dict[str, float]:
    """Seconds of each stage, the last time that it ran."""
    return {str(row["stage"]): row["seconds"] for row in read_metrics(path)}


def _json(path: Path) -> Any:
    """Content of a file; None if there is none."""
    if not path.is_file():
        return None
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise RunError(
            f"{path} is damaged ({error}); delete it and give the run's command again: it makes it anew"
        ) from error
