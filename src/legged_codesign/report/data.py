"""What the report shows, read from a run folder alone."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import codesign_bo
import yaml
from codesign_bo.confirm import Gain
from codesign_bo.records import ConfirmationRecord, TrialRecord
from codesign_bo.view import Slice
from locorl.training.metrics import read_metrics

from legged_codesign.choice import Choice


@dataclass(frozen=True)
class RunData:
    """A finished run.

    Attributes:
        trials: the search, by number.
        confirmations: the runs on fresh seeds.
        gains: each confirmed body against the nominal one.
        choice: the body that the run settled on.
        screening: zero-shot score of each screened body, the nominal one first.
        slices: posterior along each searched parameter; empty where nothing varies.
        loo: share of trials inside the 95 % interval of their leave-one-out prediction.
        pretrain: metrics of the pre-training; empty if the generalist was shipped.
        comparison: student and teacher on the same starts.
        rollout: summary of the student's run.
        stages: seconds of each stage.
        provenance: versions, machine and commit.
    """

    trials: Sequence[TrialRecord]
    confirmations: Sequence[ConfirmationRecord]
    gains: Sequence[Gain]
    choice: Choice
    screening: Sequence[Mapping[str, Any]]
    slices: Mapping[str, Slice]
    loo: float
    pretrain: Sequence[Mapping[str, float]]
    comparison: Mapping[str, Mapping[str, float]]
    rollout: Mapping[str, Any]
    stages: Mapping[str, float]
    provenance: Mapping[str, str]


def read_run(folder: Path) -> RunData:
    """Read everything that the report shows."""
    with codesign_bo.open_study(folder / "study.sqlite") as study:
        residuals = study.leave_one_out()
        return RunData(
            trials=study.trials(),
            confirmations=study.confirmations(),
            gains=study.confirmation().gains,
            choice=Choice.from_json((folder / "choice.json").read_text(encoding="utf-8")),
            screening=_json(folder / "screening.json"),
            slices=study.slices(),
            loo=residuals.coverage,
            pretrain=read_metrics(folder / "pretrain" / "metrics.jsonl"),
            comparison={
                name: row["all"] for name, row in _json(folder / "student" / "comparison.json")["means"].items()
            },
            rollout=_json(folder / "rollout.json"),
            stages=_stages(folder / "metrics.jsonl"),
            provenance=yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8"))["provenance"],
        )


def _stages(path: Path) -> dict[str, float]:
    """Seconds of each stage, the last time that it ran."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return {row["stage"]: row["seconds"] for row in rows}


def _json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))
