"""The run: pre-train, screen, search, confirm, distil, deploy, report."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import deploy
from locorl.config import to_dict
from morphgen import BodyFactory
from rich.console import Console

from legged_codesign.choice import Choice
from legged_codesign.config import RunConfig
from legged_codesign.machines import Machines
from legged_codesign.predict import predict
from legged_codesign.pretrain import check_shipped, pretrain, shipped_generalist
from legged_codesign.report.render import write_report
from legged_codesign.robots import body_factory
from legged_codesign.run_folder import Files, bind
from legged_codesign.run_log import LoggedConsole
from legged_codesign.search import BodySearch, corners, search_space
from legged_codesign.stages import Stage, locked, run_stages, write_text
from legged_codesign.student_run import StudentConfig, StudentRun, WaysOut, check_student
from legged_codesign.study_place import check_study, place_study


def run(
    config: RunConfig,
    folder: Path,
    console: Console | None = None,
    machines: Machines | None = None,
    processes: int = 1,
    retry_failed: bool = False,
    study: Path | None = None,
) -> Files:
    """Do a whole run in `folder`, or what is left of it.

    Kill it anywhere; the same call goes on from there and ends with the same result.

    Args:
        config: what to do.
        folder: run folder.
        console: where to print.
        machines: what the trials of the search run on; by default this process.
        processes: that pre-train together, each on a GPU of its own or its share of the cores.
        retry_failed: try bodies again that failed in an earlier life of the run.
        study: file to keep the search in, on a local disk; None for the run folder, or for where it is already.

    Returns:
        Where the results are.

    Raises:
        RunError: the folder belongs to another configuration, is in use or cannot be written to; or the machines of
            the search are not there, or too small.
        LookupError: no installed package knows the robot.
        ValueError: bounds or fixed values do not fit the robot, or the student does not fit the task.
    """
    folder = folder.resolve()  # machines of a cluster are at home elsewhere
    log = LoggedConsole(console or Console())
    # what cannot work must not claim the folder
    check_study(folder, study)
    planned = _Run(config, Files(folder), log, machines or Machines(), processes)
    with locked(folder):
        bind(folder, config)
        place_study(folder, study)
        with log.into(folder):
            if retry_failed:
                planned.bodies.retry_failed()
            return planned.go()


def check(config: RunConfig, factory: BodyFactory) -> None:
    """Refuse what cannot run, before anything starts.

    Raises:
        FileNotFoundError: no generalist ships for robot and task.
        ValueError: bounds or fixed values do not fit the robot, a mesh is missing that the URDF of the best body will
            need, the generalist that ships does not fit the robot's bodies, or the student does not fit the task.
    """
    factory.check_urdfs(corners(search_space(config, factory)))
    check_shipped(config, factory)
    check_eyes(config)


def check_eyes(config: RunConfig) -> None:
    """Refuse a student that must see and does not, or that would look for a way where there is none.

    Raises:
        ValueError: says what to choose instead.
    """
    blind = "take --student depth, or leave --student out"
    seeing = (
        "take --student adapted, a course such as --task highjump, or --preset paper, whose policies are told a "
        "heading on all ground"
    )
    check_student(config.pretrain.task, config.distil, f"task '{config.task}'", WaysOut(blind, seeing))


class _Run:
    """One run of the pipeline over one folder."""

    def __init__(self, config: RunConfig, files: Files, console: Console, machines: Machines, processes: int) -> None:
        self.config, self.files, self.console, self.processes = config, files, console, processes
        self.machines = machines
        self.factory = body_factory(config.robot, config.bodies)
        check(config, self.factory)
        self.bodies = BodySearch(config, files, self.factory, machines, console)

    def go(self) -> Files:
        """Do all stages."""
        prediction = predict(self.config, self.factory, self.machines)
        write_text(self.files.prediction, json.dumps({"seconds": 60 * prediction.minutes}) + "\n")
        self.console.print(f"[bold]{self.files.folder}[/bold]: {prediction}", highlight=False)
        if self.config.from_scratch and not self.files.generalist.exists():
            with self.machines.open(self.files.folder):
                pass  # what the search cannot have is better known before hours of pre-training
        first = self._search_stages()
        last = self._last_stages()
        count = len(first) + self.config.distil.stages + len(last)
        run_stages(self.files.folder, first, self.console, count)
        student = self._student()  # of the body that these have chosen
        run_stages(self.files.folder, [*student.stages(), *last], self.console, count, len(first))
        return self.files

    def _search_stages(self) -> Sequence[Stage]:
        files, bodies = self.files, self.bodies
        search = ("bodies", "objective", "bounds", "fixed", "screen", "score", "finetune")
        trials = self._part(*search, "search")
        return (
            Stage(
                "pretrain",
                self._part("bodies", "task", "from_scratch", "pretrain"),
                self._shipped(),
                [files.generalist],
                lambda: pretrain(self.config, files, self.processes),
            ),
            Stage("screen", self._part(*search), [files.generalist], [files.screening], bodies.screen),
            Stage("search", trials, [files.generalist, files.screening], [files.study, files.trials], bodies.search),
            Stage(
                "confirm",
                trials,
                [files.generalist, files.trials],
                [files.choice, files.teacher, files.best_urdf],
                bodies.confirm,
            ),
        )

    def _last_stages(self) -> Sequence[Stage]:
        files = self.files
        manifest = files.bundle / "manifest.json"
        return (
            Stage("deploy", self._part("deploy"), [manifest], [files.log, files.rollout], self.deploy),
            Stage("report", self._part(), [files.trials, files.choice, files.rollout], [files.report], self.report),
        )

    def _part(self, *names: str) -> Mapping[str, Any]:
        """The part of the configuration that a stage depends on."""
        settings = to_dict(self.config)
        return {name: settings[name] for name in ("robot", "seed", *names)}

    def _shipped(self) -> list[Path]:
        return [] if self.config.from_scratch else [shipped_generalist(self.config)]

    def _student(self) -> StudentRun:
        """The student of the chosen body's policy."""
        config, files = self.config, self.files
        choice = Choice.from_json(files.choice.read_text(encoding="utf-8"))
        student = StudentConfig(
            robot=config.robot,
            bodies=config.bodies,
            policy=str(files.teacher),
            design=tuple(choice.design(self.factory.space.names)),
            seed=config.seed,
            distil=config.distil,
        )
        return StudentRun(student, files.student, self.console, bundle=files.bundle)

    def deploy(self) -> None:
        """Run the bundle in simulation at 50 Hz, log it, measure it."""
        files, config = self.files, self.config.deploy
        summary = deploy.run(files.bundle, (config.speed, 0.0, 0.0), config.seconds, log=files.log)
        write_text(files.rollout, json.dumps(summary.to_dict(), indent=1) + "\n")
        distance = "unknown" if summary.distance_m is None else f"{summary.distance_m:.2f}"
        self.console.print(
            f"  {summary.reason}; {distance} of {summary.commanded_m:.2f} m, "
            f"{summary.energy_j_physics or summary.energy_j_50hz:.0f} J",
            highlight=False,
        )

    def report(self) -> None:
        """Write the page."""
        write_report(self.files.folder, self.config, self.factory)
