"""The run: pre-train, screen, search, confirm, distil, deploy, report."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import deploy
import numpy as np
from codesign_bo import BoxSpace, Study, sobol_designs
from locorl import EvalConfig, Policy, Trainer, evaluate, feasible, load_policy
from locorl.config import to_dict
from locorl.interfaces import Array
from morphgen.export import export_urdf
from rich.console import Console

from legged_codesign import student as student_stage
from legged_codesign.choice import Choice, choose
from legged_codesign.config import RunConfig
from legged_codesign.objective import physical, robot_scores
from legged_codesign.predict import predict
from legged_codesign.pretrained import shipped_policy
from legged_codesign.report.render import write_report
from legged_codesign.robots import body_factory
from legged_codesign.run_folder import Files, bind
from legged_codesign.stages import RunError, Stage, locked, run_stages, write_text
from legged_codesign.trial import FineTuneAndScore, trial_folder

SCREENING_SEED = 10_007
"""Added to the run's seed, so that screened bodies are not those of the study's own Sobol sequence."""


def run(config: RunConfig, folder: Path, console: Console | None = None) -> Files:
    """Do a whole run in `folder`, or what is left of it.

    Kill it anywhere; the same call goes on from there and ends with the same result.

    Args:
        config: what to do.
        folder: run folder.
        console: where to print.

    Returns:
        Where the results are.

    Raises:
        RunError: the folder belongs to another configuration, is in use or cannot be written to.
        LookupError: no installed package knows the robot.
        ValueError: bounds or fixed values do not fit the robot.
    """
    files = Files(folder)
    planned = _Run(config, files, console or Console())  # what cannot work must not claim the folder
    with locked(folder):
        bind(folder, config)
        return planned.go()


class _Run:
    """One run of the pipeline over one folder; each method is a stage and reads its inputs from disk."""

    def __init__(self, config: RunConfig, files: Files, console: Console) -> None:
        self.config, self.files, self.console = config, files, console
        self.factory = body_factory(config.robot)
        nominal = self.factory.space
        space = BoxSpace.box(list(nominal.names), list(nominal.low), list(nominal.high), list(nominal.nominal))
        space = space.with_bounds({name: (low, high) for name, low, high in config.bounds})
        self.space = space.fix(dict(config.fixed))
        self._check()

    def _check(self) -> None:
        """Refuse at once what would fail after minutes of work."""
        robot, mine = self.factory.space, self.space.parameters
        for parameter, low, high in zip(mine, robot.low, robot.high, strict=True):
            if parameter.low < low or parameter.high > high:
                raise ValueError(
                    f"bounds [{parameter.low:g}, {parameter.high:g}] of {parameter.name} leave the range "
                    f"[{low:g}, {high:g}] of '{self.factory.name}'; narrow --bounds"
                )
        if not self._feasible(self.space.designs([self.space.nominal])).all():
            raise ValueError(f"the body {self.space.nominal} has no stance; choose other values for --fix")
        self._shipped()

    def go(self) -> Files:
        """Do all stages."""
        config, files, folder = self.config, self.files, self.files.folder
        settings: Mapping[str, Any] = to_dict(config)

        def part(*names: str) -> dict[str, Any]:
            return {name: settings[name] for name in ("robot", "seed", *names)}

        search = ("objective", "bounds", "fixed", "screen", "score", "finetune", "search")
        teacher = folder / "student" / "teacher.pt"
        self.console.print(f"[bold]{folder}[/bold]: {predict(config, self.factory)}", highlight=False)
        stages = (
            Stage("pretrain", part("from_scratch", "pretrain"), self._shipped(), [files.generalist], self.pretrain),
            Stage("screen", part(*search[:6]), [files.generalist], [files.screening], self.screen),
            Stage(
                "search", part(*search), [files.generalist, files.screening], [files.study, files.trials], self.search
            ),
            Stage(
                "confirm",
                part(*search),
                [files.generalist, files.trials],
                [files.choice, teacher, folder / "best.urdf"],
                self.confirm,
            ),
            Stage(
                "distil",
                part("imitation", "student", "distill_envs", "deploy"),
                [files.choice, teacher],
                [files.bundle / "manifest.json", folder / "student" / "comparison.json"],
                self.distil,
            ),
            Stage(
                "deploy",
                part("deploy"),
                [files.bundle / "manifest.json"],
                [files.log, folder / "rollout.json"],
                self.deploy,
            ),
            Stage(
                "report",
                settings,
                [files.trials, files.choice, folder / "rollout.json"],
                [files.report],
                self.report,
            ),
        )
        run_stages(folder, stages, self.console)
        return files

    def _shipped(self) -> list[Path]:
        return [] if self.config.from_scratch else [shipped_policy(self.config.robot)]

    def _generalist(self) -> Policy:
        policy = load_policy(self.files.generalist)
        policy.check_space(self.factory.name, self.factory.space)
        return policy

    def _feasible(self, designs: Array) -> np.ndarray:
        return feasible(self.factory, designs)

    def _study(self) -> Study:
        config = self.config
        return Study(
            self.space, self.files.study, seed=config.seed, n_init=config.search.initial, feasible=self._feasible
        )

    def pretrain(self) -> None:
        """Train the generalist here, or take the shipped one."""
        if self.config.from_scratch:
            trainer = Trainer(self.factory, self.config.pretrain, self.files.generalist.parent)
            trainer.run("pre-train")
            trainer.policy().save(self.files.generalist)  # a finished training does not write it again
        else:
            load_policy(shipped_policy(self.config.robot)).save(self.files.generalist)

    def screen(self) -> None:
        """Score many bodies under the generalist as it is."""
        config = self.config
        screen, score = config.screen, config.score
        points = [
            self.space.nominal,
            *sobol_designs(self.space, screen.bodies, config.seed + SCREENING_SEED, self._feasible),
        ]
        protocol = EvalConfig(
            screen.seconds, (score.speed, score.speed), screen.seconds / 4, screen.robots, 0.1, config.seed
        )
        generalist = self._generalist()
        result = evaluate(generalist, self.factory, self.space.designs(points), generalist.card.task, protocol)
        scores = robot_scores(result, config.objective, score).mean(axis=1)
        rows = [{"params": params, "score": float(value)} for params, value in zip(points, scores, strict=True)]
        write_text(self.files.screening, json.dumps(rows, indent=1) + "\n")
        low, high = sorted(physical(float(value), config.objective) for value in (scores.min(), scores.max()))
        self.console.print(f"  {len(points)} bodies, {config.objective} {low:.3f} to {high:.3f}", highlight=False)

    def search(self) -> None:
        """Fine-tune and score bodies, proposed by screening and by the Gaussian process."""
        config = self.config
        rows = json.loads(self.files.screening.read_text(encoding="utf-8"))
        self._own_trials()
        with self._study() as study:
            if not study.screening():
                study.add_screening([row["params"] for row in rows], [row["score"] for row in rows])
            study.enqueue_screened(config.screen.promote)
            callback = FineTuneAndScore(self.factory, self._generalist(), config)
            total = config.search.trials
            study.run(callback, until=total, progress=lambda trial: self._tell(f"{trial.trial + 1}/{total}", trial))
            table = [
                {
                    "trial": t.trial,
                    "params": dict(t.params),
                    "seed": t.seed,
                    "origin": t.origin,
                    "result": json.loads(t.result.to_json()) if t.result else None,
                }
                for t in study.trials()
            ]
        write_text(self.files.trials, json.dumps(table, indent=1) + "\n")

    def _own_trials(self) -> None:
        """Trials of another generalist, left by an earlier version of this run, must not pass for this one's."""
        note = self.files.folder / "trials" / "generalist.sha256"
        mine = hashlib.sha256(self.files.generalist.read_bytes()).hexdigest()
        if note.exists() and note.read_text(encoding="utf-8") != mine:
            raise RunError(
                f"the trials in {note.parent} started from another generalist than {self.files.generalist}; "
                "restore that file or choose another --folder"
            )
        write_text(note, mine)

    def _tell(self, what: str, trial: Any) -> None:
        body = " ".join(f"{value:.3f}" for value in trial.params.values())
        if trial.result is None or not trial.result.ok:
            self.console.print(f"  {what} [{body}] {trial.status}", highlight=False)
            return
        result, objective = trial.result, self.config.objective
        error = result.extras.get("tracking_error", float("nan"))
        self.console.print(
            f"  {what} [{body}] {objective} {physical(result.mean, objective):.4f} +- {result.sem or 0:.4f}, "
            f"tracking error {error:.3f} m/s ({trial.origin})",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )

    def confirm(self) -> None:
        """Fine-tune the best bodies and the nominal one again on fresh seeds and choose."""
        config, search = self.config, self.config.search
        callback = FineTuneAndScore(self.factory, self._generalist(), config)
        total = (search.confirm + 1) * search.repeats
        with self._study() as study:
            done = sum(run.result is not None for run in study.confirmations())

            def tell(record: Any) -> None:
                nonlocal done
                done += 1
                params = study.trials()[record.trial].params
                self._tell(f"{done}/{total}", _Row(params, record.result, f"body {record.trial}, seed {record.repeat}"))

            study.confirm(callback, search.confirm, search.repeats, progress=tell)
            choice = choose(study)
        folder = trial_folder(self.files.folder, choice.trial, choice.repeat)
        (self.files.folder / "student").mkdir(exist_ok=True)
        load_policy(folder / "policy.pt").save(self.files.folder / "student" / "teacher.pt")
        write_text(self.files.choice, choice.to_json())
        design = choice.design(self.factory.space.names)
        export_urdf(self.factory, design, self.files.folder / "best.urdf")
        self.console.print(f"  {choice.sentence(config.objective)}", highlight=False, soft_wrap=True)

    def distil(self) -> None:
        """Teach a student with onboard sensing and export it."""
        files, config = self.files, self.config
        home = files.folder / "student"
        choice = Choice.from_json(files.choice.read_text(encoding="utf-8"))
        design = choice.design(self.factory.space.names)
        teacher = load_policy(home / "teacher.pt")
        self._forget_other_student(home, teacher_hash=choice.to_json())
        student = student_stage.train_student(home, self.factory, teacher, design, config)
        student_stage.compare(home / "comparison.json", self.factory, teacher, student, design, config.deploy)
        student_stage.export(files.bundle, self.factory, teacher, student, design, config)

    @staticmethod
    def _forget_other_student(home: Path, teacher_hash: str) -> None:
        """A student of another teacher, left by an earlier version of this run, must not be resumed."""
        note = home / "of.json"
        if note.exists() and note.read_text(encoding="utf-8") == teacher_hash:
            return
        for name in ("checkpoint.pt", "student.pt", "metrics.jsonl"):
            (home / name).unlink(missing_ok=True)
        write_text(note, teacher_hash)

    def deploy(self) -> None:
        """Run the bundle in simulation at 50 Hz, log it, measure it."""
        files, config = self.files, self.config.deploy
        summary = deploy.run(files.bundle, (config.speed, 0.0, 0.0), config.seconds, log=files.log)
        write_text(files.folder / "rollout.json", json.dumps(summary.to_dict(), indent=1) + "\n")
        distance = "unknown" if summary.distance_m is None else f"{summary.distance_m:.2f}"
        self.console.print(
            f"  {summary.reason}; {distance} of {summary.commanded_m:.2f} m, "
            f"{summary.energy_j_physics or summary.energy_j_50hz:.0f} J",
            highlight=False,
        )

    def report(self) -> None:
        """Write the page."""
        write_report(self.files.folder, self.config, self.factory)


@dataclass(frozen=True)
class _Row:
    """A confirmation run in the shape of a trial, for printing."""

    params: Mapping[str, float]
    result: Any
    origin: str
    status: str = "failed"
