"""Train a student by imitation: it acts, the teacher labels what it sees, it learns from the labels.

The run folder holds `checkpoint.pt` (everything needed to go on), `student.pt` (the result) and
`metrics.jsonl`. The environment is restarted with a fresh seed wherever a checkpoint is written:
an environment cannot be saved in general, and so a resumed run equals an uninterrupted one, bit by
bit, with any environment whose `reset(seed)` determines its episodes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from distill import checkpoint
from distill.collect import Collector
from distill.descent import descend
from distill.errors import CheckpointError
from distill.imitation import LossWeights, imitation_loss
from distill.interfaces import ACTIONS, VELOCITY, PrivilegedTeacher, StudentEnv, Teacher, check_env
from distill.rollouts import RolloutRing
from distill.running import check_identity, own_random_state, run, segment_seed
from distill.student import Student, StudentConfig, build_student


@dataclass(frozen=True)
class TrainConfig:
    """Hyperparameters of the imitation.

    With 256 robots the defaults visit 393 k states.
    """

    iterations: int = 64
    """Rollouts, each followed by gradient steps."""
    rollout_steps: int = 24
    """Control steps per robot and rollout."""
    segment: int = 16
    """Iterations between restarts of the environment; a checkpoint is written at each restart."""
    beta_iterations: int = 4
    """The teacher drives a share of the robots that falls linearly from 1 to 0 over these iterations."""
    ring_rollouts: int = 16
    """Rollouts that gradient steps draw from; older ones are dropped."""
    updates: int = 16
    """Gradient steps per iteration."""
    batch: int = 1024
    """States per gradient step."""
    learning_rate: float = 1e-3
    """Adam's rate at the first iteration."""
    final_rate: float = 0.1
    """Share of the rate that is left at the last iteration; linear in between."""
    max_grad_norm: float = 1.0
    """Gradients are scaled down to this norm."""
    weights: LossWeights = field(default_factory=LossWeights)
    """Weights of the losses."""
    seed: int = 0
    """Seed of weights, batches and episodes."""

    def beta(self, iteration: int) -> float:
        """Share of robots that the teacher drives."""
        return max(0.0, 1.0 - iteration / self.beta_iterations) if self.beta_iterations else 0.0

    def rate(self, iteration: int) -> float:
        """Learning rate."""
        done = iteration / max(1, self.iterations - 1)
        return self.learning_rate * (1.0 - (1.0 - self.final_rate) * done)

    def __post_init__(self) -> None:
        for name in ("iterations", "rollout_steps", "segment", "ring_rollouts", "updates", "batch"):
            if getattr(self, name) < 1:
                raise ValueError(f"TrainConfig.{name} is {getattr(self, name)}; it must be at least 1")


def train(
    env: StudentEnv,
    teacher: Teacher,
    out_dir: Path,
    config: TrainConfig | None = None,
    student: StudentConfig | None = None,
    *,
    resume: bool = True,
    progress: bool = True,
) -> Student:
    """Train a student, or go on with the training found in `out_dir`.

    Args:
        env: the environment.
        teacher: the policy to imitate. One that opens its network (`PrivilegedTeacher`) gives the
            student its actor to start from and its latent to learn.
        out_dir: run folder.
        config: hyperparameters.
        student: architecture of the student.
        resume: go on from `out_dir/checkpoint.pt` if it exists; otherwise it is overwritten.
        progress: show rate and time left on the terminal.

    Returns:
        The trained student, in evaluation mode; also in `out_dir/student.pt`.

    Raises:
        InterfaceError: the environment or teacher does not keep its contract.
        CheckpointError: the checkpoint is unreadable or belongs to another configuration.
        TrainingDiverged: something is not finite; the last checkpoint is kept.
    """
    check_env(env)
    config = config or TrainConfig()
    with own_random_state(config.seed):
        distiller = Distiller(env, teacher, config, student or StudentConfig())
        samples = config.rollout_steps * env.num_envs
        run(distiller, out_dir, config.iterations, samples, resume=resume, progress=progress)
        checkpoint.save(out_dir / "student.pt", checkpoint.student_payload(distiller.student))
    return distiller.student.eval()


class Distiller:
    """The state of one training run.

    Attributes:
        student: the network in training.
        iteration: iterations done.
    """

    def __init__(self, env: StudentEnv, teacher: Teacher, config: TrainConfig, student: StudentConfig) -> None:
        proprio = env.group_dims["proprio"]
        self.config, self.iteration = config, 0
        self.student = build_student(proprio, teacher, student, env.device)
        self._num_envs = env.num_envs
        self._optimizer = torch.optim.Adam(self.student.parameters(), lr=config.learning_rate)
        self._dims = dims = {"proprio": proprio, "explicit": VELOCITY, "action": ACTIONS}
        if isinstance(teacher, PrivilegedTeacher):
            dims["latent"] = teacher.latent_dim
        capacity = config.ring_rollouts * config.rollout_steps
        self._ring = RolloutRing(capacity, env.num_envs, self.student.config.history, dims, env.device)
        self._collector = Collector(env, teacher, self.student, self._ring)

    def segment(self) -> Iterator[dict[str, float]]:
        """Restart the environment and run up to `config.segment` iterations; yields their metrics."""
        self._collector.restart(segment_seed(self.config.seed, self.iteration))
        for _ in range(min(self.config.segment, self.config.iterations - self.iteration)):
            yield self._iterate()

    def _iterate(self) -> dict[str, float]:
        config, start = self.config, time.perf_counter()
        beta, rate = config.beta(self.iteration), config.rate(self.iteration)
        stats = self._collector.rollout(config.rollout_steps, beta)
        losses = self._update(rate)
        self.iteration += 1
        return {
            "iteration": self.iteration - 1,
            "samples": self.iteration * config.rollout_steps * self._num_envs,
            "beta": beta,
            "learning_rate": rate,
            "reward_per_step": stats.reward,
            "failures_per_step": stats.failures,
            **losses,
            "seconds": time.perf_counter() - start,
        }

    def _update(self, rate: float) -> dict[str, float]:
        """Gradient steps on the ring; the mean of every loss."""
        config = self.config

        def loss() -> dict[str, Tensor]:
            return imitation_loss(self.student, self._ring.sample(config.batch), config.weights)._asdict()

        return descend(self._optimizer, loss, config.updates, rate, config.max_grad_norm, self.iteration)

    def _identity(self) -> dict[str, object]:
        """What a checkpoint and a run must have in common."""
        return {
            "config": asdict(self.config),
            "architecture": asdict(self.student.config),
            "num_envs": self._num_envs,
            "groups": self._dims,
        }

    def state_dict(self) -> dict[str, object]:
        """Everything needed to go on from the end of a segment."""
        return {
            **self._identity(),
            **checkpoint.student_payload(self.student),
            "iteration": self.iteration,
            "optimizer": self._optimizer.state_dict(),
            "rollouts": self._ring.state_dict(),
            "random": torch.get_rng_state(),
        }

    def load_state_dict(self, state: dict[str, object], path: Path) -> None:
        """Go on from `state`, read from `path` (named in errors).

        Raises:
            CheckpointError: the checkpoint is of another run, or incomplete.
        """
        check_identity(state, self._identity(), path)
        try:
            self.student.load_state_dict(checkpoint.table(state["student"]))
            self._optimizer.load_state_dict(checkpoint.table(state["optimizer"]))
            self._ring.load_state_dict(checkpoint.table(state["rollouts"]))
            iteration, random = state["iteration"], state["random"]
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise CheckpointError(f"{path}: does not fit this student and teacher: {error}") from error
        if not isinstance(iteration, int) or not isinstance(random, torch.Tensor):
            raise CheckpointError(f"{path}: lacks its iteration or its random state")
        self.iteration = iteration
        torch.set_rng_state(random)
