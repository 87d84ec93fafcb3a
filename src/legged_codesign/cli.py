"""The `codesign` command: from a robot and a task to a better body, its controller, and the proof."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro
from deploy import DeployError
from rich.console import Console
from rich.markup import escape

from legged_codesign.config import Objective, RunConfig
from legged_codesign.presets import preset
from legged_codesign.robots import absolute, body_factory, short_name
from legged_codesign.student_run import StudentConfig, StudentRun

console = Console()


@dataclass(frozen=True)
class Run:
    """Do the whole loop; the same command goes on where a killed one stopped."""

    preset: Literal["smoke", "laptop"] = "laptop"
    """smoke: 3 minutes, proves the plumbing. laptop: at most 15 minutes on 2 cores."""
    robot: str = "go2"
    """An installed robot (entry point group legged.bodies), or the path of a .urdf (then with --from-scratch)."""
    objective: Objective = "cost-of-transport"
    """return: undiscounted reward (eq. 9). energy: positive joint work (eq. 10). cost-of-transport: the same
    per weight and way; energies count with tracking as a constraint."""
    bounds: tuple[str, ...] = ()
    """Search bounds by parameter, such as front_shank=1:1.4 hind_shank=1:1.4."""
    fix: tuple[str, ...] = ()
    """Parameters to hold, such as front_thigh=1 hind_thigh=1."""
    seed: int = 0
    trials: int | None = None
    """Bodies to fine-tune in the search; None keeps the preset's number."""
    from_scratch: bool = False
    """Pre-train here instead of starting from the shipped generalist (some 10 minutes more)."""
    folder: Path | None = None
    """Run folder; by default runs/<preset>-<robot>-<objective>."""

    def config(self) -> RunConfig:
        """The configuration that these options stand for."""
        config = preset(self.preset, self.objective)
        search = config.search if self.trials is None else replace(config.search, trials=self.trials)
        return replace(
            config,
            robot=absolute(self.robot),
            seed=self.seed,
            bounds=tuple(parse_bounds(text) for text in self.bounds),
            fixed=tuple(parse_fixed(text) for text in self.fix),
            from_scratch=self.from_scratch or config.from_scratch,
            search=search,
        )

    def run(self) -> None:
        """Run and say where the results are."""
        from legged_codesign.pipeline import run

        folder = self.folder or Path("runs") / f"{self.preset}-{short_name(self.robot)}-{self.objective}"
        started = time.monotonic()
        files = run(self.config(), folder, console)
        console.print(f"\nfinished in {(time.monotonic() - started) / 60:.1f} min", highlight=False)
        for what, path in (
            ("report", files.report),
            ("bundle", files.bundle),
            ("log", files.log),
            ("best URDF", files.folder / "best.urdf"),
        ):
            console.print(f"  {what:<10} {path}", highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class Student:
    """Make a student of a shipped generalist for one body; the same command goes on where a killed one stopped.

    Fine-tunes the generalist on the body while velocity estimator and history encoder (ROA) learn beside it, distils,
    compares student and teacher, and writes a bundle.
    """

    robot: str = "go2"
    """An installed robot (entry point group legged.bodies), or the path of a .urdf."""
    policy: str = "go2-flat"
    """The generalist: the name of a shipped one (go2-flat, go2-rough, lite3-parkour), or the path of a policy."""
    design: tuple[float, ...] = ()
    """Design parameters in the order of the design space, such as 1 1.2 1 1.2; by default the nominal body."""
    terrain: tuple[str, ...] = ()
    """Kinds of terrain, such as hurdles; by default those of the generalist."""
    depth: bool = False
    """The student sees: a depth camera takes the place of the height scan and of the way to go."""
    adapt_iterations: int = 40
    """Of the fine-tune."""
    iterations: int | None = None
    """Of the student's training; None keeps the default of a blind or a seeing one."""
    robots: int | None = None
    """That the student is trained with; None: 256 for a blind one, 128 for one that sees."""
    seed: int = 0
    video: Path | None = None
    """Film of teacher and student side by side, as an .mp4."""
    folder: Path | None = None
    """Run folder; by default runs/student-<policy>."""

    def config(self) -> StudentConfig:
        """The configuration that these options stand for."""
        config = StudentConfig()
        tune = replace(config.adapt.finetune, iterations=self.adapt_iterations)
        few = {} if self.iterations is None else {"iterations": self.iterations}
        return replace(
            config,
            robot=absolute(self.robot),
            policy=str(Path(self.policy).resolve()) if Path(self.policy).is_file() else self.policy,
            design=self.design,
            terrain=self.terrain,
            depth=self.depth,
            seed=self.seed,
            adapt=replace(config.adapt, finetune=tune),
            robots=self.robots or (128 if self.depth else 256),
            imitation=replace(config.imitation, **few),
            vision=replace(config.vision, **few),
        )

    def run(self) -> None:
        """Run and say where the bundle is."""
        folder = self.folder or Path("runs") / f"student-{Path(self.policy).stem}{'-depth' if self.depth else ''}"
        work = StudentRun(self.config(), folder, console)
        bundle = work.run()
        if self.video is not None:
            work.scores(self.video)
        console.print(f"bundle: {bundle}; `distill inspect {bundle}` explains it", highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class Report:
    """Write the report of a run folder again, from what is on disk."""

    folder: Annotated[Path, tyro.conf.Positional]

    def run(self) -> None:
        """Write it."""
        from legged_codesign.report.render import write_report
        from legged_codesign.run_folder import read_config

        config = read_config(self.folder)
        console.print(str(write_report(self.folder, config, body_factory(config.robot))), soft_wrap=True)


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


def main() -> None:
    """Entry point of the `codesign` command."""
    command = tyro.cli(Run | Student | Report, prog="codesign", description=__doc__)
    try:
        command.run()
    except KeyboardInterrupt:
        console.print("\nstopped; the same command goes on from here")
        sys.exit(130)
    except (OSError, RuntimeError, ValueError, LookupError, DeployError) as error:
        if os.environ.get("CODESIGN_TRACEBACK"):
            raise
        console.print(f"[red]error:[/red] {escape(str(error))}", highlight=False, soft_wrap=True)
        sys.exit(1)
