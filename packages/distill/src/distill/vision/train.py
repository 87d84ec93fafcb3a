"""Train a seeing student: it acts, the teacher labels, depth encoder and backbone learn with one optimiser.

Files and exactness are those of `distill.train`: the environment is restarted with a fresh seed wherever a checkpoint
is written, and a resumed run equals an uninterrupted one, bit by bit.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import torch
from torch import Tensor

from distill import checkpoint
from distill.adaptation.modules import AdaptationModule, has_scan
from distill.descent import descend
from distill.errors import CheckpointError, InterfaceError
from distill.interfaces import Teacher, VisionEnv, check_env
from distill.running import check_identity, own_random_state, run, segment_seed
from distill.vision.collect import VisionCollector
from distill.vision.config import VisionStudentConfig, VisionTrainConfig
from distill.vision.losses import vision_loss
from distill.vision.sequences import SequenceMemory
from distill.vision.student import VisionStudent, build_vision_student, vision_payload
from distill.vision.unroll import unroll


def train_vision(
    env: VisionEnv,
    teacher: Teacher,
    out_dir: Path,
    config: VisionTrainConfig | None = None,
    student: VisionStudentConfig | None = None,
    adaptation: AdaptationModule | None = None,
    *,
    resume: bool = True,
    progress: bool = True,
) -> VisionStudent:
    """Train a seeing student, or go on with the training found in `out_dir`.

    Args:
        env: robots with cameras.
        teacher: the policy to imitate. One that opens its network and sees the terrain (`ScanTeacher`) gives the
            student its actor to start from.
        out_dir: run folder.
        config: hyperparameters.
        student: architecture and timing.
        adaptation: estimator and history encoder prepared in the teacher's rollouts; they are used as they are.
            Not read without ROA.
        resume: go on from `out_dir/checkpoint.pt` if it exists; otherwise it is overwritten.
        progress: show rate and time left on the terminal.

    Returns:
        The trained student, in evaluation mode; also in `out_dir/student.pt`.

    Raises:
        InterfaceError: environment, teacher or adaptation do not keep their contract.
        CheckpointError: the checkpoint is unreadable or belongs to another configuration.
        TrainingDiverged: something is not finite; the last checkpoint is kept.
    """
    check_env(env)
    config = config or VisionTrainConfig()
    with own_random_state(config.seed):
        distiller = VisionDistiller(env, teacher, config, student or VisionStudentConfig(), adaptation)
        samples = config.rollout_steps * env.num_envs
        run(distiller, out_dir, config.iterations, samples, resume=resume, progress=progress)
        checkpoint.save(out_dir / "student.pt", vision_payload(distiller.student))
    return distiller.student.eval()


class VisionDistiller:
    """The state of one training run.

    Attributes:
        student: the networks in training.
        iteration: iterations done.
    """

    def __init__(
        self,
        env: VisionEnv,
        teacher: Teacher,
        config: VisionTrainConfig,
        student: VisionStudentConfig,
        adaptation: AdaptationModule | None,
    ) -> None:
        if config.rollout_steps % env.depth_period:
            raise InterfaceError(
                f"VisionTrainConfig.rollout_steps is {config.rollout_steps}; "
                f"it must be a multiple of the camera's period, {env.depth_period} steps"
            )
        if config.roa and adaptation is None:
            raise InterfaceError(
                "training with ROA needs the estimator and history encoder prepared in the teacher's rollouts: "
                "pass `adaptation` (see distill.adaptation), or set VisionTrainConfig.roa=False"
            )
        if config.latent_supervision and not has_scan(teacher):
            raise InterfaceError("this teacher has no scan latent to supervise with; set latent_supervision=False")
        self.config, self.iteration = config, 0
        self.student = build_vision_student(env, teacher, student, adaptation if config.roa else None)
        self.student.adaptation.requires_grad_(not config.roa)
        self._num_envs = env.num_envs
        self._trained = [p for p in self.student.parameters() if p.requires_grad]
        self._optimizer = torch.optim.Adam(self._trained, lr=config.learning_rate)
        self._memory = SequenceMemory(config.memory)
        self._collector = VisionCollector(
            env, teacher, self.student, config.threshold, config.mts, config.latent_supervision
        )

    def segment(self) -> Iterator[dict[str, float]]:
        """Restart the environment and run up to `config.segment` iterations; yields their metrics."""
        self._collector.restart(segment_seed(self.config.seed, self.iteration))
        for _ in range(min(self.config.segment, self.config.iterations - self.iteration)):
            yield self._iterate()

    def _iterate(self) -> dict[str, float]:
        config, start = self.config, time.perf_counter()
        rate = config.rate(self.iteration)
        sequence, stats = self._collector.rollout(config.rollout_steps)
        self._memory.add(sequence)
        losses = self._update(rate)
        self.iteration += 1
        return {
            "iteration": self.iteration - 1,
            "samples": self.iteration * config.rollout_steps * self._num_envs,
            "learning_rate": rate,
            "reward_per_step": stats.reward,
            "failures_per_step": stats.failures,
            "heading_error": stats.heading_error,
            "predicted_use": stats.predicted_use,
            "within_half_threshold": stats.within_half,
            **losses,
            "seconds": time.perf_counter() - start,
        }

    def _update(self, rate: float) -> dict[str, float]:
        """Gradient steps on the memory; the mean of every loss."""
        config = self.config

        def loss() -> dict[str, Tensor]:
            sequence = self._memory.sample(config.batch)
            found = unroll(self.student, sequence, config.threshold if config.mts else None)
            return vision_loss(found, sequence, config, self.student.config.heading_limit)._asdict()

        return descend(self._optimizer, loss, config.updates, rate, config.max_grad_norm, self.iteration)

    def _identity(self) -> dict[str, object]:
        """What a checkpoint and a run must have in common."""
        student = self.student
        return {
            "config": asdict(self.config),
            "architecture": asdict(student.config),
            "num_envs": self._num_envs,
            "camera": [*student.depth_shape, student.depth_period],
        }

    def state_dict(self) -> dict[str, object]:
        """Everything needed to go on from the end of a segment."""
        return {
            **self._identity(),
            **vision_payload(self.student),
            "iteration": self.iteration,
            "optimizer": self._optimizer.state_dict(),
            "rollouts": self._memory.state_dict(),
            "random": torch.get_rng_state(),
        }

    def load_state_dict(self, state: dict[str, object], path: Path) -> None:
        """Go on from `state`, read from `path` (named in errors).

        Raises:
            CheckpointError: the checkpoint is of another run, or incomplete.
        """
        check_identity(state, self._identity(), path)
        try:
            self.student.load_state_dict(checkpoint.table(checkpoint.table(state["vision"])["weights"]))
            self._optimizer.load_state_dict(checkpoint.table(state["optimizer"]))
            self._memory.load_state_dict(checkpoint.table(state["rollouts"]), self._trained[0].device)
            iteration, random = state["iteration"], state["random"]
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise CheckpointError(f"{path}: does not fit this student and teacher: {error}") from error
        if not isinstance(iteration, int) or not isinstance(random, torch.Tensor):
            raise CheckpointError(f"{path}: lacks its iteration or its random state")
        self.iteration = iteration
        torch.set_rng_state(random)
