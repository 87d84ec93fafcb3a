"""Reads a run folder, in whatever state it is, without writing to it."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from legged_codesign.choice import Choice
from legged_codesign.objective import UNITS
from legged_codesign.run_folder import Files
from legged_codesign.run_log import LOG, PROGRESS, Progress
from legged_codesign.stages import in_use
from legged_codesign.watch.files import CachedFile, JsonLines, StudyFile, Tables, last_lines, write_ahead_log
from legged_codesign.watch.state import Curve, RunState, StageState, StageStatus, Status
from legged_codesign.watch.tables import best_trial, confirmation_rows, search_left, trial_rows

LOG_LINES = 40
_POINTS = 300
"""Most points of a curve."""
_RECENT = 20
"""Iterations that the time left is predicted from."""


@dataclass(frozen=True)
class _Training:
    """Where a stage leaves its metrics, and what is drawn of them."""

    stage: str
    places: Sequence[str]
    quantities: Mapping[str, str]


_TRAININGS = (
    _Training("pretrain", ("pretrain",), {"reward": "reward per step", "tracking_error": "tracking error [m/s]"}),
    _Training("adapt", ("student/adapt", "adapt"), {"reward": "reward per step"}),
    _Training(
        "distil",
        ("student/student", "student"),
        {"reward_per_step": "reward per step", "action_loss": "action loss", "loss": "loss"},
    ),
)


class RunReader:
    """Reads one run folder again and again; files that have not changed are read once.

    Args:
        folder: of the run, or what may become one.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.files = folder, Files(folder)
        stages = folder / "stages"
        self._config = CachedFile(folder / "config.yaml", _settings)
        self._progress = CachedFile(stages / PROGRESS, Progress.from_json)
        self._prediction = CachedFile(self.files.prediction, lambda text: float(json.loads(text)["seconds"]))
        self._choice = CachedFile(self.files.choice, Choice.from_json)
        self._seconds = JsonLines(folder / "metrics.jsonl")
        self._study = StudyFile(self.files.study)
        self._metrics = {
            training.stage: [JsonLines(folder / place / "metrics.jsonl") for place in training.places]
            for training in _TRAININGS
        }

    def read(self) -> RunState:
        """The run as it is now; what cannot be read is named in `problems`."""
        config = self._config.read()
        if config is None:
            return self._without_config()
        held = in_use(self.folder)
        tables, choice, objective = self._study.read(), self._choice.read(), config.get("objective", "")
        metrics = {name: next((rows for f in files if (rows := f.read())), ()) for name, files in self._metrics.items()}
        stages = self._stages(config, held, tables, metrics)
        elapsed = sum(stage.seconds or 0.0 for stage in stages)
        trials = trial_rows(tables, objective, held)
        best = choice.trial if choice else best_trial(tables)
        status, words = self._verdict(stages, held)
        return RunState(
            folder=str(self.folder),
            status=status,
            words=words,
            problems=[p for p in (self._study.problem, self._choice.problem) if p],
            title=" ".join(str(config[key]) for key in ("preset", "robot", "task", "objective") if key in config),
            objective=objective,
            unit=UNITS.get(objective, ""),
            higher_is_better=objective == "return",
            stages=stages,
            elapsed=elapsed,
            left=self._left(stages, elapsed) if status == "running" else None,
            idle=self._idle(),
            trials=trials,
            planned=config.get("search", {}).get("trials"),
            confirmations=confirmation_rows(tables, objective, held),
            best=best,
            best_params=dict(tables.trials[best].params) if best is not None and best < len(tables.trials) else {},
            best_is_final=choice is not None,
            result=choice.sentence(objective) if choice else "",
            curves=_curves(metrics),
            log=last_lines(self.folder / LOG, LOG_LINES),
            command=self._began_by(),
            report=self.files.report.is_file(),
        )

    def _without_config(self) -> RunState:
        """What there is to say of a folder that has no readable configuration."""
        path, log = self.folder / "config.yaml", last_lines(self.folder / LOG, LOG_LINES)
        status: Status = "no run"
        if self._config.problem:
            status = "damaged"
            words = f"{self._config.problem}; restore it, or start the run in another --folder"
        elif not self.folder.is_dir():
            words = f"there is no folder {self.folder}"
        elif in_use(self.folder):
            status, words = "running", "the run is starting"
        elif (self.folder / ".lock").exists():
            status, words = "not begun", "the run ended before it began; the same command begins it"
        else:
            words = f"{self.folder} holds no run: {path} is missing"
        return RunState(str(self.folder), status, words, log=log, idle=self._idle())

    def _stages(
        self, config: Mapping[str, Any], held: bool, tables: Tables, metrics: Mapping[str, Sequence[Mapping[str, Any]]]
    ) -> list[StageState]:
        progress: Progress | None = self._progress.read()
        seconds = {row["stage"]: row.get("seconds") for row in self._seconds.read() if "stage" in row}
        names = stage_names(config)
        if progress is not None and progress.stage not in names:
            names.append(progress.stage)
        now = names.index(progress.stage) if progress else len(names)
        stages = []
        for number, name in enumerate(names):
            marked = (self.folder / "stages" / f"{name}.json").is_file()
            status: StageStatus = "done" if marked and number < now else "to do"
            took, left = seconds.get(name) if status == "done" else None, None
            done, total = self._count(name, config, tables, metrics)
            if progress and number == now:
                status, took = ("running", max(0.0, time.time() - progress.since)) if held else ("stopped", None)
                if held:
                    left = self._stage_left(name, done, total, tables, metrics)
            if status in ("done", "to do"):
                done = total = None
            stages.append(StageState(name, status, took, left, done, total))
        return stages

    @staticmethod
    def _count(
        name: str, config: Mapping[str, Any], tables: Tables, metrics: Mapping[str, Sequence[Mapping[str, Any]]]
    ) -> tuple[int | None, int | None]:
        search, distil = config.get("search", {}), config.get("distil") or {}
        if name == "search":
            return sum(t.result is not None for t in tables.trials), search.get("trials")
        if name == "confirm" and "confirm" in search:
            finished = sum(run.result is not None for run in tables.confirmations)
            return finished, (search["confirm"] + 1) * search["repeats"]
        totals = {
            "pretrain": config.get("pretrain"),
            "adapt": (distil.get("adapt") or {}).get("finetune"),
            "distil": distil.get("vision" if distil.get("depth") else "imitation"),
        }
        total = (totals.get(name) or {}).get("iterations")
        return (len(metrics[name]), total) if total and metrics.get(name) else (None, None)

    @staticmethod
    def _stage_left(
        name: str,
        done: int | None,
        total: int | None,
        tables: Tables,
        metrics: Mapping[str, Sequence[Mapping[str, Any]]],
    ) -> float | None:
        if done is None or total is None:
            return None
        if name in ("search", "confirm"):
            return search_left(tables, total - done, time.time())
        recent = [row["seconds"] for row in metrics[name][-_RECENT:] if "seconds" in row]
        return max(0, total - done) * statistics.mean(recent) if recent else None

    def _left(self, stages: Sequence[StageState], elapsed: float) -> float | None:
        """Until the end: what was predicted at the start, but no less than the present stage still needs."""
        predicted = self._prediction.read()
        now = next((stage.left for stage in stages if stage.status == "running"), None)
        if predicted is None:
            return now
        return max(predicted - elapsed, now or 0.0) or None

    def _verdict(self, stages: Sequence[StageState], held: bool) -> tuple[Status, str]:
        done = sum(stage.status == "done" for stage in stages)
        current = next((stage for stage in stages if stage.status in ("running", "stopped")), None)
        if held:
            if current is None:
                return "running", "the run is starting"
            return "running", f"stage {stages.index(current) + 1} of {len(stages)}, {current.name}, is running"
        command = self._began_by()
        way_on = "the same command goes on from there" + (f": {command}" if command.startswith("codesign ") else "")
        if current is not None:
            where = f"stage {stages.index(current) + 1} of {len(stages)}, {current.name}"
            return "stopped", f"killed, stopped or failed in {where}: no process holds the folder; {way_on}"
        if done == len(stages):
            return "finished", f"finished; read {self.files.report}" if self.files.report.is_file() else "finished"
        if done == 0:
            return "not begun", f"the run ended before its first stage; {way_on}"
        return "stopped", f"stopped after {done} of {len(stages)} stages: no process holds the folder; {way_on}"

    def _began_by(self) -> str:
        progress: Progress | None = self._progress.read()
        return progress.command if progress else ""

    def _idle(self) -> float | None:
        """Seconds since something was written."""
        written = []
        names = (LOG, "config.yaml", "metrics.jsonl", "stages", "trials")
        study = self.files.study
        for path in (*(self.folder / name for name in names), study, write_ahead_log(study)):
            try:
                written.append(path.stat().st_mtime)
            except OSError:
                continue
        for training in _TRAININGS:
            for place in training.places:
                path = self.folder / place / "metrics.jsonl"
                if path.is_file():
                    written.append(path.stat().st_mtime)
        return max(0.0, time.time() - max(written)) if written else None


def stage_names(config: Mapping[str, Any]) -> list[str]:
    """The stages of the run, or of the student, that a configuration describes, in order."""
    distil = config.get("distil") or {}
    student = (
        ["distil", "compare", "export"] if distil.get("adapt") is None else ["adapt", "distil", "compare", "export"]
    )
    if "search" not in config:
        return student
    return ["pretrain", "screen", "search", "confirm", *student, "deploy", "report"]


def _settings(text: str) -> Mapping[str, Any]:
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(f"it is no YAML ({' '.join(str(error).split())})") from error
    config = content.get("config") if isinstance(content, dict) else None
    if not isinstance(config, dict) or not ("search" in config or "policy" in config):
        raise ValueError("it is not the configuration of a run")
    return config


def _curves(metrics: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Curve]:
    curves = []
    for training in _TRAININGS:
        rows = metrics[training.stage]
        for key, quantity in training.quantities.items():
            points = [(row["samples"], row[key]) for row in rows if key in row and "samples" in row]
            if points:
                step = -(-len(points) // _POINTS)
                curves.append(Curve(training.stage, quantity, [*points[:-1:step], points[-1]]))
    return curves
