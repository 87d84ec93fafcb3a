"""The stages of a run that choose a body: screen, search, confirm."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from codesign_bo import BoxSpace, Callback, Study, sobol_designs
from codesign_bo.header import Direction
from locorl import EvalConfig, Policy, evaluate, feasible, load_policy
from locorl.interfaces import Array
from morphgen import BodyFactory
from morphgen.export import export_urdf
from rich.console import Console

from legged_codesign.baselines import run_baseline
from legged_codesign.choice import choose
from legged_codesign.config import RunConfig
from legged_codesign.machines import Machines
from legged_codesign.objective import physical, robot_scores
from legged_codesign.run_folder import Files
from legged_codesign.stages import RunError, forget, write_text
from legged_codesign.trial import FineTuneAndScore, trial_folder

SCREENING_SEED = 10_007
"""Added to the run's seed, so that screened bodies are not those of the study's own Sobol sequence."""


def search_space(config: RunConfig, factory: BodyFactory) -> BoxSpace:
    """The design space of the robot within the run's bounds and with what it holds fixed.

    Raises:
        ValueError: bounds or fixed values do not fit the robot.
    """
    robot = factory.space
    space = BoxSpace.box(list(robot.names), list(robot.low), list(robot.high), list(robot.nominal))
    space = space.with_bounds({name: (low, high) for name, low, high in config.bounds}).fix(dict(config.fixed))
    for parameter, low, high in zip(space.parameters, robot.low, robot.high, strict=True):
        if parameter.low < low or parameter.high > high:
            raise ValueError(
                f"bounds [{parameter.low:g}, {parameter.high:g}] of {parameter.name} leave the range "
                f"[{low:g}, {high:g}] of '{factory.name}'; narrow --bounds"
            )
    if not feasible(factory, space.designs([space.nominal])).all():
        raise ValueError(f"the body {space.nominal} has no stance; choose other values for --fix")
    return space


def corners(space: BoxSpace) -> Array:
    """The designs with all parameters at their lower and at their upper bounds, (2, d); what is fixed stays."""
    bounds = ((p.nominal, p.nominal) if p.fixed else (p.low, p.high) for p in space.parameters)
    return np.array(list(bounds), dtype=np.float64).T


class BodySearch:
    """The search of one run; each method is a stage and reads its inputs from disk.

    Args:
        config: the run.
        files: of the run.
        factory: makes the bodies.
        machines: what trials run on.
        console: where to print.

    Raises:
        ValueError: bounds or fixed values do not fit the robot.
    """

    def __init__(
        self, config: RunConfig, files: Files, factory: BodyFactory, machines: Machines, console: Console
    ) -> None:
        self.config, self.files, self.factory, self.machines, self.console = config, files, factory, machines, console
        self.space = search_space(config, factory)

    def screen(self) -> None:
        """Score many bodies under the generalist as it is."""
        config = self.config
        screen, score = config.screen, config.score
        points = [
            self.space.nominal,
            *sobol_designs(self.space, screen.bodies, config.seed + SCREENING_SEED, self._feasible),
        ]
        protocol = EvalConfig(screen.seconds, score.vx, screen.seconds / 4, screen.robots, 0.1, config.seed)
        generalist, designs = self._generalist(), self.space.designs(points)
        task, simulator = generalist.card.task, config.finetune.simulator
        result = evaluate(generalist, self.factory, designs, task, protocol, simulator=simulator)
        scores = robot_scores(result, config.objective, score).mean(axis=1)
        columns = (scores, result.through.sum(axis=1), result.tracking_error.mean(axis=1))
        rows = [
            {"params": params, "score": float(value), "through": int(through), "tracking_error": float(error)}
            for params, value, through, error in zip(points, *columns, strict=True)
        ]
        write_text(self.files.screening, json.dumps(rows, indent=1) + "\n")
        low, high = sorted(physical(float(value), config.objective) for value in (scores.min(), scores.max()))
        self.console.print(f"  {len(points)} bodies, {config.objective} {low:.3f} to {high:.3f}", highlight=False)

    def search(self) -> None:
        """Fine-tune and score bodies, proposed by screening and by the Gaussian process, or by a baseline."""
        search = self.config.search
        self._own_trials()
        with self._study() as study, self.machines.open(self.files.folder) as executor:

            def tell(trial: Any) -> None:
                self._tell(f"{study.finished()}/{search.trials}", trial)

            run = partial(study.run, self._callback(), executor=executor, progress=tell)
            if search.method == "codesign-bo":
                self._screened(study)
                run(until=search.trials)
            else:
                run_baseline(
                    study,
                    search.method,
                    search.trials,
                    self.machines.workers,
                    lambda params: bool(self._feasible(self.space.designs([params])).all()),
                    lambda until: run(until=until),
                )
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

    def confirm(self) -> None:
        """Fine-tune the best bodies and the nominal one again on fresh seeds and choose."""
        config, search = self.config, self.config.search
        total = (search.confirm + 1) * search.repeats
        with self._study() as study, self.machines.open(self.files.folder) as executor:
            done = sum(run.result is not None for run in study.confirmations())

            def tell(record: Any) -> None:
                nonlocal done
                done += 1
                params, what = study.trials()[record.trial].params, f"body {record.trial}, seed {record.repeat}"
                self._print(f"{done}/{total}", params, record.result, "failed", what)

            study.confirm(self._callback(), search.confirm, search.repeats, progress=tell, executor=executor)
            choice = choose(study)
        folder = trial_folder(self.files.folder, choice.trial, choice.repeat)
        load_policy(folder / "policy.pt").save(self.files.teacher)
        write_text(self.files.choice, choice.to_json())
        export_urdf(self.factory, choice.design(self.factory.space.names), self.files.best_urdf)
        self.console.print(f"  {choice.sentence(config.objective)}", highlight=False, soft_wrap=True)

    def retry_failed(self) -> None:
        """Have failed bodies and confirmation runs done again, whose failure was not theirs."""
        if not self.files.study.is_file():
            return
        forget(self.files.folder, "search", "confirm")  # first: a run killed in between finds nothing to do there
        with self._study() as study:
            self.console.print(f"{study.retry_failed()} failed trials and confirmation runs are tried again")

    def _feasible(self, designs: Array) -> np.ndarray:
        return feasible(self.factory, designs)

    def _study(self) -> Study:
        config, search = self.config, self.config.search
        other: Mapping[str, Direction] = (
            {"energy": "minimize"} if config.objective == "return" else {"return": "maximize"}
        )
        return Study(
            self.space,
            self.files.study,
            seed=config.seed,
            n_init=search.initial,
            feasible=self._feasible,
            objectives=other if search.pareto else {},
        )

    def _generalist(self) -> Policy:
        policy = load_policy(self.files.generalist)
        policy.check_bodies(self.factory, "choose another --folder")
        return policy

    def _callback(self) -> Callback:
        return FineTuneAndScore(self.config, self._generalist(), self.machines.threads)

    def _screened(self, study: Study) -> None:
        """Tell the study of the screened bodies, and let the best of them go first."""
        rows = json.loads(self.files.screening.read_text(encoding="utf-8"))
        if not study.screening():
            study.add_screening([row["params"] for row in rows], [row["score"] for row in rows])
        study.enqueue_screened(self.config.screen.promote)

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
        self._print(what, trial.params, trial.result, trial.status, trial.origin)

    def _print(self, what: str, params: Mapping[str, Any], result: Any, status: str, origin: str) -> None:
        """A line for a trial or a confirmation run."""
        body = " ".join(f"{value:.3f}" for value in params.values())
        line = f"  {what} [{body}] {status}"
        if result is not None and result.ok:
            objective, extras = self.config.objective, result.extras
            came = f", {extras['succeeded']:.0f} of {result.n} through" if "succeeded" in extras else ""
            line = (
                f"  {what} [{body}] {objective} {physical(result.mean, objective):.4f} +- {result.sem or 0:.4f}, "
                f"tracking error {extras.get('tracking_error', float('nan')):.3f} m/s{came} ({origin})"
            )
        self.console.print(line, highlight=False, markup=False, soft_wrap=True)
