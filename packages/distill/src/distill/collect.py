"""Visit states with the student and have the teacher label them (DAgger, Ross et al. 2011)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from distill.errors import TrainingDiverged
from distill.history import HistoryBuffer
from distill.interfaces import Observation, PrivilegedTeacher, StudentEnv, Teacher
from distill.rollouts import RolloutRing
from distill.student import Student
from distill.teachers import knowledge


@dataclass(frozen=True)
class RolloutStats:
    """Averages over one rollout: reward per step, and share of steps on which a robot failed."""

    reward: float
    failures: float


class Collector:
    """Rolls the student, mixed with the teacher, and fills the ring.

    Args:
        env: the environment.
        teacher: labels every visited state.
        student: acts.
        ring: receives proprio, explicit, action and, with a privileged teacher, its latents.
    """

    def __init__(self, env: StudentEnv, teacher: Teacher, student: Student, ring: RolloutRing) -> None:
        self._env, self._teacher, self._student, self._ring = env, teacher, student, ring
        self._encoder = teacher if isinstance(teacher, PrivilegedTeacher) else None
        self._history = HistoryBuffer(env.num_envs, student.config.history, student.proprio, env.device)
        self._age = torch.zeros(env.num_envs, dtype=torch.int64, device=env.device)
        self._obs: Observation = {}

    def restart(self, seed: int) -> None:
        """Begin new episodes everywhere."""
        self._obs = self._env.reset(seed=seed)
        self._history.reset()
        self._age.zero_()

    @torch.no_grad()
    def rollout(self, steps: int, beta: float) -> RolloutStats:
        """Take `steps` control steps.

        Args:
            steps: control steps per robot.
            beta: share of robots that the teacher drives during this rollout.

        Raises:
            TrainingDiverged: an observation, label or action is not finite.
        """
        device = self._env.device
        taught = (torch.rand(self._env.num_envs) < beta).to(device)[:, None]
        reward_sum, failures = torch.zeros((), device=device), torch.zeros((), device=device)
        for _ in range(steps):
            label = self._label()
            action, _, history = self._student(self._obs["proprio"], self._history.frames)
            self._history.update(history)
            self._obs, reward, terminated, truncated, _ = self._env.step(torch.where(taught, label, action))
            done = terminated | truncated
            self._history.reset(done)
            self._age = torch.where(done, 0, self._age + 1)
            reward_sum += reward.mean()
            failures += terminated.float().mean()
        return RolloutStats((reward_sum / steps).item(), (failures / steps).item())

    def _label(self) -> Tensor:
        """Store the present state with the teacher's labels; return its action (N, 12)."""
        fields = {
            "proprio": self._obs["proprio"],
            "explicit": self._obs["explicit"],
            "action": self._teacher.act(self._obs),
        }
        if self._encoder is not None:
            fields["latent"] = knowledge(self._encoder, self._obs)
        for name, value in fields.items():
            if not torch.isfinite(value).all():
                source = "the environment's group" if name in self._obs else "the teacher's"
                raise TrainingDiverged(f"{source} '{name}' holds values that are not finite")
        self._ring.add(fields, self._age)
        return fields["action"]
