"""Score a policy, student or teacher alike, over one episode of every robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from distill.interfaces import Observation, StudentEnv, Teacher


@runtime_checkable
class MemoryPolicy(Protocol):
    """A student as a policy, blind or seeing."""

    @property
    def velocity(self) -> Tensor:
        """Base velocity (N, 3) estimated by the last `act`, base frame, m/s."""
        ...

    def act(self, obs: Observation) -> Tensor:
        """Action, (N, 12)."""
        ...

    def reset(self, done: Tensor | None = None) -> None:
        """Forget what the robots in `done` ((N,) bool), or all of them, know."""
        ...


@dataclass(frozen=True)
class Score:
    """Over N robots, each from the start to its first end of episode or the horizon.

    Attributes:
        returns: (N,) sum of rewards.
        survived: (N,) bool, the robot did not fail.
        velocity_error: root mean square error of the estimated base velocity, m/s; None for a teacher.
    """

    returns: Tensor
    survived: Tensor
    velocity_error: float | None


@torch.no_grad()
def evaluate(env: StudentEnv, policy: MemoryPolicy | Teacher, steps: int, seed: int) -> Score:
    """Roll a policy with its mean action.

    Args:
        env: the environment.
        policy: student or teacher.
        steps: horizon in control steps.
        seed: of the episodes; give student and teacher the same.
    """
    student = policy if isinstance(policy, MemoryPolicy) else None
    obs = env.reset(seed=seed)
    if student:
        student.reset()
    running = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
    survived = running.clone()
    returns, squared = torch.zeros(env.num_envs, device=env.device), torch.zeros((), device=env.device)
    samples = 0
    for _ in range(steps):
        action = policy.act(obs)
        if student:
            squared += (student.velocity - obs["explicit"])[running].square().sum()
            samples += int(running.sum()) * obs["explicit"].shape[1]
        obs, reward, terminated, truncated, _ = env.step(action)
        returns += reward * running
        survived &= ~(terminated & running)
        done = terminated | truncated
        running &= ~done
        if student:
            student.reset(done)
        if not running.any():
            break
    error = float((squared / samples).sqrt()) if student else None
    return Score(returns, survived, error)
