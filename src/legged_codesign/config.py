"""The configuration of a co-design run: one frozen tree, written to disk before anything starts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import distill
import locorl

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

    def __post_init__(self) -> None:
        """Refuse a search that ends without a comparison."""
        for name, least in (("trials", 2), ("initial", 1), ("confirm", 1), ("repeats", 2)):
            if getattr(self, name) < least:
                raise ValueError(f"SearchConfig.{name} is {getattr(self, name)}; it must be at least {least}")


@dataclass(frozen=True)
class ScoreConfig:
    """How a body is scored under a policy."""

    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seconds: float = 10.0
    """Length of an episode, s."""
    robots: int = 32
    """Robots, which start from different joint angles."""
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
class RunConfig:
    """Everything that determines a run.

    Attributes:
        preset: where the numbers come from.
        robot: name of an installed body factory (entry point group `legged.bodies`), or path of a URDF.
        objective: what a body is scored by.
        seed: of everything random.
        bounds: design parameters searched within other bounds, (name, low, high).
        fixed: design parameters held at a value, (name, value).
        from_scratch: pre-train here instead of starting from the shipped generalist.
        pretrain: the pre-training.
        finetune: the fine-tuning of one body.
        imitation: the training of the student.
        student: its architecture.
        distill_envs: robots in the student's training.
    """

    preset: str = "laptop"
    robot: str = "go2"
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
    imitation: distill.TrainConfig = field(default_factory=distill.TrainConfig)
    student: distill.StudentConfig = field(default_factory=distill.StudentConfig)
    distill_envs: int = 256
    deploy: DeployConfig = field(default_factory=DeployConfig)

    def __post_init__(self) -> None:
        """Refuse what no random stream can start from."""
        if self.seed < 0:
            raise ValueError(f"the seed is {self.seed}; it must not be negative")
