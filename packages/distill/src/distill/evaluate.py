"""Score a policy, student or teacher alike, over one episode of every robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from distill.interfaces import GroupedEnv, Observation, StudentEnv, Teacher


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
        tracking_error: (N,) mean |commanded speed - speed|, m/s; None if the environment does not tell.
        succeeded: (N,) bool, the robot did all it had to; None if the environment does not tell.
        groups: what robots differ in -> each robot's group, (N,).
    """

    returns: Tensor
    survived: Tensor
    velocity_error: float | None
    tracking_error: Tensor | None = None
    succeeded: Tensor | None = None
    groups: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def summary(self, robots: Tensor | None = None) -> dict[str, float]:
        """Means over the robots (n,) bool, or all: "robots", "return", "survived" and, if known, "tracking_error",
        "succeeded" and, of all, "velocity_error".
        """
        rows = torch.ones_like(self.survived) if robots is None else robots
        means = {"return": self.returns, "survived": self.survived}
        if self.succeeded is not None:
            means["succeeded"] = self.succeeded
        if self.tracking_error is not None:
            means["tracking_error"] = self.tracking_error
        found = {
            "robots": float(rows.sum()),
            **{name: float(each[rows].float().mean()) for name, each in means.items()},
        }
        if robots is None and self.velocity_error is not None:
            found["velocity_error"] = self.velocity_error
        return found

    def by(self, what: str) -> dict[str, dict[str, float]]:
        """The summary of each group of robots, in the order of their names.

        Args:
            what: key of `groups`.
        """
        names = self.groups[what]
        return {
            group: self.summary(torch.tensor([name == group for name in names], device=self.survived.device))
            for group in sorted(set(names))
        }


@torch.no_grad()
def evaluate(
    env: StudentEnv,
    policy: MemoryPolicy | Teacher,
    steps: int,
    seed: int,
    watch: Callable[[], object] | None = None,
) -> Score:
    """Roll a policy with its mean action.

    Args:
        env: the environment.
        policy: student or teacher.
        steps: horizon in control steps.
        seed: of the episodes; give student and teacher the same.
        watch: called before each step, such as to take a picture.
    """
    student = policy if isinstance(policy, MemoryPolicy) else None
    obs = env.reset(seed=seed)
    groups = env.groups() if isinstance(env, GroupedEnv) else {}
    if student:
        student.reset()
    running = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
    survived, succeeded = running.clone(), torch.zeros_like(running)
    returns, wrong, judged = (torch.zeros(env.num_envs, device=env.device) for _ in range(3))
    squared, samples = torch.zeros((), device=env.device), 0
    tracked = judged_success = False
    for _ in range(steps):
        if watch is not None:
            watch()
        action = policy.act(obs)
        if student:
            squared += (student.velocity - obs["explicit"])[running].square().sum()
            samples += int(running.sum()) * obs["explicit"].shape[1]
        obs, reward, terminated, truncated, info = env.step(action)
        if (error := _measured(info, "tracking_error")) is not None:
            tracked = True
            wrong += error * running
            judged += running
        if (success := _measured(info, "success")) is not None:
            judged_success = True
            succeeded |= success & running
        returns += reward * running
        survived &= ~(terminated & running)
        done = terminated | truncated
        running &= ~done
        if student:
            student.reset(done)
        if not running.any() and watch is None:
            break
    return Score(
        returns,
        survived,
        float((squared / max(samples, 1)).sqrt()) if student else None,
        wrong / judged.clamp(min=1) if tracked else None,
        succeeded if judged_success else None,
        groups,
    )


def _measured(info: object, name: str) -> Tensor | None:
    """What an environment tells of a step (see `Measured`); None if it does not."""
    return getattr(info, name, None)
