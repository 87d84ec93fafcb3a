"""`codesign student`: a student of a generalist for one body."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from legged_codesign.adapt import AdaptConfig
from legged_codesign.commands.body import BodyOptions
from legged_codesign.config import DistilConfig
from legged_codesign.robots import absolute
from legged_codesign.student_run import StudentConfig, StudentRun


@dataclass(frozen=True)
class Student(BodyOptions):
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
        distil, adapt = DistilConfig(), AdaptConfig()
        few = {} if self.iterations is None else {"iterations": self.iterations}
        return StudentConfig(
            robot=absolute(self.robot),
            bodies=self.bodies,
            policy=str(Path(self.policy).resolve()) if Path(self.policy).is_file() else self.policy,
            design=self.design,
            terrain=self.terrain,
            seed=self.seed,
            distil=replace(
                distil,
                depth=self.depth,
                adapt=replace(adapt, finetune=replace(adapt.finetune, iterations=self.adapt_iterations)),
                robots=self.robots or (128 if self.depth else 256),
                imitation=replace(distil.imitation, **few),
                vision=replace(distil.vision, **few),
            ),
        )

    def run(self, console: Console) -> None:
        """Run and say where the bundle is."""
        folder = self.folder or Path("runs") / f"student-{Path(self.policy).stem}{'-depth' if self.depth else ''}"
        work = StudentRun(self.config(), folder, console)
        bundle = work.run()
        if self.video is not None:
            work.scores(self.video)
        console.print(f"bundle: {bundle}; `distill inspect {bundle}` explains it", highlight=False, soft_wrap=True)
