"""The configuration of a co-design run: one frozen tree, written to disk before anything starts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import distill
import locorl

from legged_codesign.adapt import AdaptConfig
from legged_codesign.robots import BodyConfig
from legged_codesign.tasks import TaskName

SearchMethod = Literal["codesign-bo", "random", "sobol", "hyperopt-tpe", "optuna-tpe", "optuna-gp", "cma-es"]
Objective = Literal["return", "energy", "cost-of-transport"]


@dataclass(frozen=True)
class ScreenConfig:
    """Zero-shot scores of many bodies under the generalist, to choose what to fine-tune first."""

    bodies: int = 128
    """Feasible bodies of a scrambled Sobol sequence."""
    robots: int = 4
    """Robots on each."""
    seconds: float = 8.0
    """Length of an episode, s."""
    promote: int = 5
    """The best of them (apart from one another) become the first trials after the nominal body."""


@dataclass(frozen=True)
class SearchConfig:
    """Bayesian optimisation over bodies, each fine-tuned before it is scored (Algorithm 2)."""

    trials: int = 16
    """Bodies to fine-tune in all; trial 0 is the nominal one."""
    initial: int = 8
    """Trials before the Gaussian process proposes, promoted ones included."""
    confirm: int = 2
    """Bodies to confirm against the nominal one ..."""
    repeats: int = 3
    """... on this many fresh seeds, which all share."""
    method: SearchMethod = "codesign-bo"
    """What proposes bodies after the nominal one; the others are there to compare with (extra
    `legged-codesign-bo[baselines]`), and take neither screened bodies nor several objectives. hyperopt-tpe is what the
    paper's authors ran."""
    pareto: bool = False
    """Search for the best compromises of return and energy instead of one objective alone."""

    def __post_init__(self) -> None:
        """Refuse a search that ends without a comparison."""
        for name, least in (("trials", 2), ("initial", 1), ("confirm", 1), ("repeats", 2)):
            if getattr(self, name) < least:
                raise ValueError(f"SearchConfig.{name} is {getattr(self, name)}; it must be at least {least}")
        if self.pareto and self.method != "codesign-bo":
            raise ValueError(f"SearchConfig: '{self.method}' knows one objective alone; leave pareto out")


@dataclass(frozen=True)
class ScoreConfig:
    """How a body is scored under a policy."""

    vx: tuple[float, float] = (0.6, 0.6)
    """Range of the commanded forward speeds, m/s."""
    seconds: float = 10.0
    """Length of an episode, s."""
    robots: int = 32
    """Robots, which start from different joint angles and are spread over all levels of the terrain."""
    max_error: float = 0.1
    """Mean tracking error beyond this is penalised, m/s."""


@dataclass(frozen=True)
class DeployConfig:
    """The final run of the student."""

    speed: float = 0.5
    """Commanded forward speed, m/s."""
    seconds: float = 20.0
    """Time under control of the student, s."""


@dataclass(frozen=True)
class DistilConfig:
    """From a body's policy to a student on onboard sensing (section III-D)."""

    depth: bool = False
    """The student sees: a depth camera takes the place of the height scan and of the way to go."""
    adapt: AdaptConfig | None = field(default_factory=AdaptConfig)
    """Fine-tune of the teacher beside estimator and history encoder (ROA); None imitates the teacher as it is."""
    robots: int = 256
    """That the student is trained with."""
    simulator: locorl.SimulatorConfig = field(default_factory=locorl.SimulatorConfig)
    """On which they are simulated."""
    imitation: distill.TrainConfig = field(default_factory=distill.TrainConfig)
    """Training of a blind student."""
    student: distill.StudentConfig = field(default_factory=distill.StudentConfig)
    """Its architecture."""
    vision: distill.VisionTrainConfig = field(default_factory=distill.VisionTrainConfig)
    """Training of a seeing student."""
    vision_student: distill.VisionStudentConfig = field(default_factory=distill.VisionStudentConfig)
    """Its architecture and timing."""
    camera: locorl.DepthConfig = field(default_factory=locorl.DepthConfig.small)
    """Of a seeing student."""
    judged: locorl.EvalConfig = field(
        default_factory=lambda: locorl.EvalConfig(robots_per_body=100, reset_joint=0.1, seed=4242)
    )
    """How teacher and student are compared; speed, seconds, robots and seed."""

    @property
    def stages(self) -> int:
        """Stages of a run that make the student."""
        return 3 if self.adapt is None else 4

    @property
    def samples(self) -> int:
        """Environment steps of the fine-tune and of the student's training."""
        train = self.vision if self.depth else self.imitation
        tuning = 0 if self.adapt is None else self.adapt.finetune.samples
        return tuning + train.iterations * train.rollout_steps * self.robots


@dataclass(frozen=True)
class RunConfig:
    """Everything that determines a run.

    Attributes:
        preset: where the numbers come from.
        task: what bodies are searched for.
        robot: name of an installed body factory (entry point group `legged.bodies`), or path of a URDF.
        bodies: how its bodies follow from designs.
        objective: what a body is scored by.
        seed: of everything random.
        bounds: design parameters searched within other bounds, (name, low, high).
        fixed: design parameters held at a value, (name, value).
        from_scratch: pre-train here instead of starting from the shipped generalist.
        pretrain: the pre-training.
        screen: the screening.
        search: the search and its confirmation.
        finetune: the fine-tuning of one body.
        score: how a body is scored.
        distil: the student.
        deploy: its final run.
    """

    preset: str = "laptop"
    task: TaskName = "flat"
    robot: str = "go2"
    bodies: BodyConfig = field(default_factory=BodyConfig)
    objective: Objective = "cost-of-transport"
    seed: int = 0
    bounds: tuple[tuple[str, float, float], ...] = ()
    fixed: tuple[tuple[str, float], ...] = ()
    from_scratch: bool = False
    pretrain: locorl.TrainConfig = field(default_factory=locorl.TrainConfig)
    screen: ScreenConfig = field(default_factory=ScreenConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    finetune: locorl.FinetuneConfig = field(default_factory=locorl.FinetuneConfig)
    score: ScoreConfig = field(default_factory=ScoreConfig)
    distil: DistilConfig = field(default_factory=DistilConfig)
    deploy: DeployConfig = field(default_factory=DeployConfig)

    def __post_init__(self) -> None:
        """Refuse what no random stream can start from."""
        if self.seed < 0:
            raise ValueError(f"the seed is {self.seed}; it must not be negative")
