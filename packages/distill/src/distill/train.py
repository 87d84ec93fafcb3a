"""Train a student by imitation: it acts, the teacher labels what it sees, it learns from the labels."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path

from torch import Tensor

from distill.collect import Collector
from distill.imitation import LossWeights, imitation_loss
from distill.interfaces import ACTIONS, VELOCITY, PrivilegedTeacher, StudentEnv, Teacher, check_env, check_teacher
from distill.rollouts import RolloutRing
from distill.student import Student, StudentConfig, blind_payload, build_student
from distill.teachers import scan_width
from distill.training import ScheduleConfig, Training, own_random_state


@dataclass(frozen=True)
class TrainConfig(ScheduleConfig):
    """Hyperparameters of the imitation.

    With 256 robots the defaults visit 393 k states.
    """

    beta_iterations: int = 4
    """The teacher drives a share of the robots that falls linearly from 1 to 0 over these iterations."""
    ring_rollouts: int = 16
    """Rollouts that gradient steps draw from; older ones are dropped."""
    batch: int = 1024
    """States per gradient step."""
    weights: LossWeights = field(default_factory=LossWeights)
    """Weights of the losses."""

    def beta(self, iteration: int) -> float:
        """Share of robots that the teacher drives."""
        return max(0.0, 1.0 - iteration / self.beta_iterations) if self.beta_iterations else 0.0

    def __post_init__(self) -> None:
        """Refuse a training that does nothing."""
        super().__post_init__()
        self._at_least_one("ring_rollouts", "batch")


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
            student its actor to start from and its latents to learn.
        out_dir: run folder, see `distill.training`.
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
    check_teacher(env, teacher)
    config = config or TrainConfig()
    with own_random_state(config.seed):
        distiller = Distiller(env, teacher, config, student or StudentConfig())
        distiller.run(out_dir, resume=resume, progress=progress)
    return distiller.student.eval()


class Distiller(Training[Student]):
    """The training of a blind student."""

    def __init__(self, env: StudentEnv, teacher: Teacher, config: TrainConfig, student: StudentConfig) -> None:
        proprio = env.group_dims["proprio"]
        network = build_student(proprio, teacher, student, env.device)
        self.config = config
        self._dims = dims = {"proprio": proprio, "explicit": VELOCITY, "action": ACTIONS}
        if isinstance(teacher, PrivilegedTeacher):
            dims["latent"] = scan_width(teacher) + teacher.latent_dim
        capacity = config.ring_rollouts * config.rollout_steps
        self._ring = RolloutRing(capacity, env.num_envs, network.config.history, dims, env.device)
        self._collector = Collector(env, teacher, network, self._ring)
        super().__init__(config, network, self._ring, env.num_envs)

    def restart(self, seed: int) -> None:
        """Begin new episodes everywhere."""
        self._collector.restart(seed)

    def collect(self) -> dict[str, float]:
        """Roll the student, mixed with the teacher."""
        beta = self.config.beta(self.iteration)
        stats = self._collector.rollout(self.config.rollout_steps, beta)
        return {"beta": beta, "reward_per_step": stats.reward, "failures_per_step": stats.failures}

    def loss(self) -> dict[str, Tensor]:
        """Errors on states drawn from the ring."""
        return imitation_loss(self.student, self._ring.sample(self.config.batch), self.config.weights)._asdict()

    def identity(self) -> dict[str, object]:
        """Architecture and widths."""
        return {"architecture": asdict(self.student.config), "groups": self._dims}

    def payload(self) -> dict[str, object]:
        """The student."""
        return blind_payload(self.student)
