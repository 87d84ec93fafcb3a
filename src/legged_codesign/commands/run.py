"""`codesign run`: the whole loop."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from locorl import SimulatorConfig
from rich.console import Console

from legged_codesign.adapt import AdaptConfig
from legged_codesign.commands.body import BodyOptions
from legged_codesign.config import Objective, RunConfig, SearchMethod
from legged_codesign.machines import ExecutorName, Machines
from legged_codesign.presets import HARDWARE_BOUNDS, HARDWARE_FIXED, default_objective, on_simulator, preset
from legged_codesign.robots import absolute, body_factory, short_name
from legged_codesign.tasks import TaskName, find_task

PAPERS_SEEDS = (0, 1, 2)
"""Section IV-A2: three independent runs."""


@dataclass(frozen=True)
class Run(BodyOptions):
    """Do the whole loop; the same command goes on where a killed one stopped."""

    preset: Literal["smoke", "laptop", "workstation", "paper"] = "laptop"
    """smoke: 3 minutes, proves the plumbing. laptop: at most 15 minutes on 2 cores. workstation: one GPU or many cores,
    hours. paper: section IV to the letter, for GPUs."""
    task: TaskName = "flat"
    """What bodies are searched for: level ground, stairs, hills, a slope, or a course to jump."""
    robot: str | None = None
    """An installed robot (entry point group legged.bodies), or the path of a .urdf (then with --from-scratch); by
    default the paper's for the task, go2 or lite3."""
    objective: Objective | None = None
    """return: undiscounted reward (eq. 9). energy: positive joint work (eq. 10). cost-of-transport: the same
    per weight and way; energies count with tracking as a constraint. By default return with the preset paper, else
    cost-of-transport."""
    pareto: bool = False
    """Search for the best compromises of the objective and return, or of return and energy if that is the objective; it
    still decides among them."""
    bounds: tuple[str, ...] = ()
    """Search bounds by parameter, such as front_shank=1:1.4 hind_shank=1:1.4."""
    fix: tuple[str, ...] = ()
    """Parameters to hold, such as front_thigh=1 hind_thigh=1."""
    hardware: bool = False
    """The bounds of the paper's search on hardware (section IV-C1): shanks alone, 1 to 1.4."""
    student: Literal["plain", "adapted", "depth"] | None = None
    """plain: imitates the body's policy. adapted: estimator and ROA come first. depth: it sees, too, where
    policies are told a way to find: on courses, and with --preset paper. None: what suits the task."""
    search: SearchMethod = "codesign-bo"
    """What proposes bodies; the others are baselines (extra legged-codesign-bo[baselines])."""
    seed: int | None = None
    """Of everything random; by default 0."""
    seeds: tuple[int, ...] = ()
    """Several runs, one after the other, each in a folder of its own; by default three with the preset paper (section
    IV-A2), unless there is a --seed."""
    trials: int | None = None
    """Bodies to fine-tune in the search; None keeps the preset's number."""
    iterations: int | None = None
    """Of each fine-tune; None keeps the preset's number."""
    repeats: int | None = None
    """Fresh seeds that the best bodies are confirmed on; more of them separate smaller gains. None keeps the preset's
    number."""
    from_scratch: bool = False
    """Pre-train here instead of starting from the shipped generalist (some 10 minutes more)."""
    simulator: Literal["cpu", "warp"] = "cpu"
    """cpu: MuJoCo's thread pool. warp: MuJoCo Warp (extra legged-locorl[gpu])."""
    device: str = "cuda"
    """Of the simulator warp."""
    processes: int = 1
    """That pre-train together, each on a GPU of its own or its share of the cores (torchrun)."""
    executor: ExecutorName = "local"
    """Where trials run: this machine, a Ray cluster, a Slurm cluster."""
    workers: int = 1
    """Trials at once."""
    cpus: int | None = None
    """Cores of each trial; None shares out those of this machine."""
    gpus: float = 0.0
    """GPUs of each trial."""
    hours: float = 24.0
    """Longest time of a trial on a worker."""
    partition: str = ""
    """Of Slurm."""
    retry_failed: bool = False
    """Try bodies again that failed, once their cause is repaired; the others keep their results."""
    dry_run: bool = False
    """Print every number with its source and the predicted cost, and do nothing."""
    folder: Path | None = None
    """Run folder; by default runs/<preset>-<robot>-<task>-<objective>."""
    study: Path | None = None
    """File of the search, on a local disk of this machine, for a run folder on a network file system; remembered there.
    With --seeds its name gets the seed."""

    @property
    def chosen_robot(self) -> str:
        """The robot, or the one that goes with the task."""
        return self.robot or find_task(self.task).robot

    def config(self) -> RunConfig:
        """The configuration that these options stand for.

        Raises:
            ValueError: an option is malformed, or the student does not fit the task.
        """
        from legged_codesign.pipeline import check_eyes

        config = preset(self.preset, self.objective, self.task)
        more_bounds, more_fixed = (HARDWARE_BOUNDS, HARDWARE_FIXED) if self.hardware else ((), ())
        numbers = {"trials": self.trials, "repeats": self.repeats}
        chosen = {name: value for name, value in numbers.items() if value is not None}
        search = replace(config.search, method=self.search, pareto=self.pareto, **chosen)
        finetune = config.finetune
        if self.iterations is not None:
            finetune = replace(finetune, iterations=self.iterations)
        distil = config.distil
        if self.student is not None:
            adapt = None if self.student == "plain" else distil.adapt or AdaptConfig()
            distil = replace(distil, depth=self.student == "depth", adapt=adapt)
        config = replace(
            config,
            robot=absolute(self.chosen_robot),
            bodies=self.bodies,
            seed=self.seed or 0,
            bounds=(*more_bounds, *(parse_bounds(text) for text in self.bounds)),
            fixed=(*more_fixed, *(parse_fixed(text) for text in self.fix)),
            from_scratch=self.from_scratch or config.from_scratch,
            pretrain=replace(config.pretrain, seed=max(0, self.seed or 0)),
            search=search,
            finetune=finetune,
            distil=distil,
        )
        check_eyes(config)
        return config if self.simulator == "cpu" else on_simulator(config, SimulatorConfig(self.simulator, self.device))

    def machines(self) -> Machines:
        """What the trials run on."""
        return Machines(self.executor, self.workers, self.cpus, self.gpus, self.hours, self.partition)

    def run(self, console: Console) -> None:
        """Run, or say what would be done."""
        from legged_codesign.pipeline import check, run
        from legged_codesign.plan import print_plan
        from legged_codesign.study_place import check_study

        objective = self.objective or default_objective(self.preset)
        name = f"{self.preset}-{short_name(self.chosen_robot)}-{self.task}-{objective}"
        folder = self.folder or Path("runs") / name
        if self.dry_run:
            config = self.config()
            factory = body_factory(config.robot, config.bodies)
            check(config, factory)
            for seed in self._seeds():
                check_study(*self._places(folder, seed))
            print_plan(config, factory, self.machines(), console)
            if len(self._seeds()) > 1:
                seeds = ", ".join(map(str, self._seeds()))
                console.print(f"{len(self._seeds())} such runs, one after the other, with the seeds {seeds}")
            return
        for seed in self._seeds():
            one, (where, study) = replace(self, seed=seed), self._places(folder, seed)
            started = time.monotonic()
            files = run(one.config(), where, console, self.machines(), self.processes, self.retry_failed, study)
            console.print(f"\nfinished in {(time.monotonic() - started) / 60:.1f} min", highlight=False)
            for what, path in (
                ("report", files.report),
                ("bundle", files.bundle),
                ("log", files.log),
                ("best URDF", files.best_urdf),
            ):
                console.print(f"  {what:<10} {path}", highlight=False, soft_wrap=True)

    def _seeds(self) -> tuple[int, ...]:
        if self.seeds or self.seed is not None:
            return self.seeds or (self.seed or 0,)
        return PAPERS_SEEDS if self.preset == "paper" else (0,)

    def _places(self, folder: Path, seed: int) -> tuple[Path, Path | None]:
        """Folder and study of the run with a seed."""
        if not self.seeds and len(self._seeds()) == 1:
            return folder, self.study
        return folder / f"seed-{seed}", self.study and self.study.with_stem(f"{self.study.stem}-{seed}")


def parse_bounds(text: str) -> tuple[str, float, float]:
    """`front_shank=1:1.4` as name, low, high.

    Raises:
        ValueError: with the right form.
    """
    name, _, values = text.partition("=")
    low, _, high = values.partition(":")
    try:
        return name, float(low), float(high)
    except ValueError:
        raise ValueError(f"--bounds {text}: write it as name=low:high, such as front_shank=1:1.4") from None


def parse_fixed(text: str) -> tuple[str, float]:
    """`front_thigh=1` as name, value.

    Raises:
        ValueError: with the right form.
    """
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise ValueError(f"--fix {text}: write it as name=value, such as front_thigh=1") from None
