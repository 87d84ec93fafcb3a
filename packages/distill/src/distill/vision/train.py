"""Train a seeing student: it acts, the teacher labels, depth encoder and backbone learn with one optimiser.

Files and exactness are those of `distill.training`.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from torch import Tensor

from distill.adaptation.modules import AdaptationModule
from distill.errors import InterfaceError
from distill.interfaces import Teacher, VisionEnv, check_env, check_teacher
from distill.teachers import has_scan
from distill.training import Training, own_random_state
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
    check_teacher(env, teacher)
    config = config or VisionTrainConfig()
    with own_random_state(config.seed):
        distiller = VisionDistiller(env, teacher, config, student or VisionStudentConfig(), adaptation)
        distiller.run(out_dir, resume=resume, progress=progress)
    return distiller.student.eval()


class VisionDistiller(Training[VisionStudent]):
    """The training of a seeing student."""

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
        self.config = config
        network = build_vision_student(env, teacher, student, adaptation if config.roa else None)
        network.adaptation.requires_grad_(not config.roa)
        self._memory = SequenceMemory(config.memory, env.device)
        self._collector = VisionCollector(
            env, teacher, network, config.threshold, config.mts, config.latent_supervision
        )
        super().__init__(config, network, self._memory, env.num_envs)

    def restart(self, seed: int) -> None:
        """Begin new episodes everywhere."""
        self._collector.restart(seed)

    def collect(self) -> dict[str, float]:
        """Roll the student under MTS."""
        sequence, stats = self._collector.rollout(self.config.rollout_steps)
        self._memory.add(sequence)
        return {
            "reward_per_step": stats.reward,
            "failures_per_step": stats.failures,
            "heading_error": stats.heading_error,
            "predicted_use": stats.predicted_use,
            "within_half_threshold": stats.within_half,
        }

    def loss(self) -> dict[str, Tensor]:
        """Errors on a part of one of the last rollouts."""
        config = self.config
        sequence = self._memory.sample(config.batch)
        found = unroll(self.student, sequence, config.threshold if config.mts else None)
        return vision_loss(found, sequence, config, self.student.config.heading_limit)._asdict()

    def identity(self) -> dict[str, object]:
        """Architecture and camera."""
        student = self.student
        return {"architecture": asdict(student.config), "camera": [*student.depth_shape, student.depth_period]}

    def payload(self) -> dict[str, object]:
        """The student."""
        return vision_payload(self.student)
