"""`distill train`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console

from distill.adaptation.modules import load_adaptation
from distill.commands.providing import Provided, with_cameras
from distill.comparison import print_scores
from distill.errors import DistillError
from distill.evaluate import MemoryPolicy, evaluate
from distill.interfaces import StudentEnv, Teacher
from distill.policy import StudentPolicy
from distill.student import StudentConfig
from distill.train import TrainConfig, train
from distill.vision.config import VisionStudentConfig, VisionTrainConfig
from distill.vision.policy import VisionPolicy
from distill.vision.train import train_vision


@dataclass(frozen=True)
class Train(Provided):
    """Train a student of a privileged teacher, or go on where the run folder stopped."""

    out: Path = field(kw_only=True)
    """Run folder: checkpoint.pt, student.pt, metrics.jsonl."""
    resume: bool = True
    """Go on from the checkpoint in the run folder."""
    eval_steps: int = 500
    """Horizon of the closing comparison of student and teacher, in control steps; 0: none."""
    seeing: bool = False
    """The student sees: it has a depth encoder, and finds its way itself."""
    adaptation: Path | None = None
    """Estimator and history encoder of a seeing student, prepared while its teacher was fine-tuned."""
    mts: bool = True
    """Ablation of a seeing student: without, the predicted heading is always used, however wrong it is."""
    roa: bool = True
    """Ablation of a seeing student: without, estimator and history encoder are trained from scratch."""
    blind: bool = False
    """Ablation of a seeing student: the camera shows nothing."""
    latent_supervision: bool = False
    """Ablation of a seeing student: the terrain latent is also drawn to the teacher's."""
    train: TrainConfig = field(default_factory=TrainConfig)
    """Imitation, of a student that does not see."""
    student: StudentConfig = field(default_factory=StudentConfig)
    """Its architecture."""
    vision: VisionTrainConfig = field(default_factory=VisionTrainConfig)
    """Training of a seeing student; an ablation asked for here or above is done."""
    vision_student: VisionStudentConfig = field(default_factory=VisionStudentConfig)
    """Its architecture and timing."""

    def run(self, console: Console) -> None:
        """Train, then compare student and teacher on the same fresh episodes."""
        self._check()
        env, teacher = self.make_env(), self.load_teacher()
        policy = self._seeing(env, teacher) if self.seeing else self._not_seeing(env, teacher)
        console.print(f"student: {self.out / 'student.pt'}", soft_wrap=True)
        if self.eval_steps:
            seed = (self.vision if self.seeing else self.train).seed + 1
            policies: dict[str, MemoryPolicy | Teacher] = {"teacher": teacher, "student": policy}
            print_scores(console, {name: evaluate(env, each, self.eval_steps, seed) for name, each in policies.items()})

    def _check(self) -> None:
        """Refuse options that would not have any effect, before anything is loaded."""
        changed = {
            "--no-mts": not self.mts,
            "--no-roa": not self.roa,
            "--blind": self.blind,
            "--latent-supervision": self.latent_supervision,
            "--adaptation": self.adaptation is not None,
        }
        if idle := [name for name, is_changed in changed.items() if is_changed and not self.seeing]:
            raise DistillError(f"{', '.join(idle)}: only a seeing student has that; add --seeing")
        roa = self._vision().roa
        if self.seeing and not roa and self.adaptation is not None:
            raise DistillError("--adaptation is not read without ROA; leave it or --no-roa out")
        if self.seeing and roa and self.adaptation is None:
            raise DistillError(
                "a seeing student needs the estimator and history encoder that were prepared with its teacher: give "
                "--adaptation FILE (`codesign student` writes one), or --no-roa to train them from scratch"
            )

    def _not_seeing(self, env: StudentEnv, teacher: Teacher) -> MemoryPolicy:
        student = train(env, teacher, self.out, self.train, self.student, resume=self.resume)
        return StudentPolicy(student, env.num_envs, env.device)

    def _seeing(self, env: StudentEnv, teacher: Teacher) -> MemoryPolicy:
        robots = with_cameras(env, self.env)
        config = self._vision()
        adaptation = None if self.adaptation is None else load_adaptation(self.adaptation, env.device)
        student = replace(self.vision_student, blind=self.blind or self.vision_student.blind)
        found = train_vision(robots, teacher, self.out, config, student, adaptation, resume=self.resume)
        return VisionPolicy(found, robots)

    def _vision(self) -> VisionTrainConfig:
        """The training of a seeing student, with the ablations."""
        vision = self.vision
        supervised = self.latent_supervision or vision.latent_supervision
        return replace(vision, mts=self.mts and vision.mts, roa=self.roa and vision.roa, latent_supervision=supervised)
