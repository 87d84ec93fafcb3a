"""Visit states with the seeing student, follow MTS, and have the teacher label them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from distill.errors import InterfaceError, TrainingDiverged
from distill.history import HistoryBuffer
from distill.interfaces import ACTIONS, VELOCITY, Observation, Teacher, VisionEnv
from distill.teachers import has_scan
from distill.vision.depth_encoder import NOTHING
from distill.vision.mts import choose, heading_difference, near
from distill.vision.perception import Percept, Perception
from distill.vision.sequences import Sequence
from distill.vision.student import VisionStudent


@dataclass(frozen=True)
class VisionRolloutStats:
    """Averages over one rollout; those of headings are over the steps at which an image was in use.

    Attributes:
        reward: per step.
        failures: share of steps on which a robot failed.
        heading_error: mean |prediction - oracle| of the first heading, rad.
        predicted_use: share of steps on which the prediction was used.
        within_half: share of steps on which every prediction was within half the threshold.
    """

    reward: float
    failures: float
    heading_error: float
    predicted_use: float
    within_half: float


class VisionCollector:
    """Rolls the student and records what happens.

    Args:
        env: the environment.
        teacher: labels every visited state.
        student: acts.
        threshold: of MTS, rad.
        mts: whether the oracle's heading is used where the prediction is further off.
        scan_latent: whether the teacher's scan latents are recorded.
    """

    def __init__(
        self, env: VisionEnv, teacher: Teacher, student: VisionStudent, threshold: float, mts: bool, scan_latent: bool
    ) -> None:
        self._env, self._teacher, self._student = env, teacher, student
        self._threshold, self._mts = threshold, mts
        self._scan = teacher if scan_latent and has_scan(teacher) else None
        self._history = HistoryBuffer(env.num_envs, student.history, student.proprio, env.device)
        self._perception = Perception(student, env.num_envs, env.device)
        self._first = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
        self._obs: Observation = {}

    def restart(self, seed: int) -> None:
        """Begin new episodes everywhere."""
        self._obs = self._env.reset(seed=seed)
        self._history.reset()
        self._perception.reset()
        self._first = torch.ones_like(self._first)

    @torch.no_grad()
    def rollout(self, steps: int) -> tuple[Sequence, VisionRolloutStats]:
        """Take `steps` control steps, a multiple of the camera's period.

        Raises:
            TrainingDiverged: an image, observation, label or action is not finite.
            InterfaceError: environment or teacher give something of another shape than they promised.
        """
        env, rows = self._env, _Rows()
        start = {"history": self._history.frames, **self._perception.state()._asdict()}
        sums = torch.zeros(6, device=env.device)
        for _ in range(steps):
            self._label(rows)
            percept = self._look(rows)
            oracle = self._obs["proprio"][:, self._student.heading]
            use, tally = self._judge(percept, oracle)
            action, _, history = self._student(
                self._obs["proprio"], percept.terrain, choose(percept.heading, oracle, use), self._history.frames
            )
            self._history.update(history)
            self._obs, reward, terminated, truncated, _ = env.step(action)
            self._first = terminated | truncated
            self._history.reset(self._first)
            self._perception.reset(self._first)
            sums += torch.stack((reward.mean(), terminated.float().mean(), *tally))
        reward, failures, seen, *heading = sums.tolist()
        error, used, within = (value / max(seen, 1.0) for value in heading)
        return Sequence(**rows.stacked(), **start), VisionRolloutStats(
            reward / steps, failures / steps, error, used, within
        )

    def _label(self, rows: _Rows) -> None:
        """Record the present state with the teacher's labels."""
        obs, student, robots = self._obs, self._student, self._env.num_envs
        scan = torch.zeros(robots, 0, device=self._env.device)
        if self._scan is not None:
            scan = self._scan.scan_latent(obs)
        rows.add("first", self._first, (robots,))
        rows.add("proprio", obs["proprio"], (robots, student.proprio))
        rows.add("explicit", obs["explicit"], (robots, VELOCITY))
        rows.add("action", self._teacher.act(obs), (robots, ACTIONS))
        rows.add("scan_latent", scan, (robots, student.config.terrain_dim if self._scan is not None else 0))

    def _look(self, rows: _Rows) -> Percept:
        """Record the image, if one is due, and take it in."""
        features = None
        if self._perception.due:
            depth = self._env.depth
            rows.add("depth", depth, (self._env.num_envs, *self._student.depth_shape))
            if (brightest := float(depth.abs().max())) > NOTHING + 1e-3:
                raise InterfaceError(
                    f"'depth' reaches {brightest:.3g}; its pixels must run from -{NOTHING} (near) to {NOTHING} (far)"
                )
            features = self._student.features(depth)
        return self._perception.step(features, self._obs["proprio"])

    def _judge(self, percept: Percept, oracle: Tensor) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Where predicted headings (N, K) are used, (N,); counts of seen, error, used and within half, () each."""
        close = near(percept.heading, oracle, self._threshold)
        use = close if self._mts else torch.ones_like(close)
        error = heading_difference(percept.heading, oracle)[:, 0]
        half = near(percept.heading, oracle, 0.5 * self._threshold)
        seen = percept.seen
        return use, (seen.sum(), error[seen].sum(), (use & seen).sum(), (half & seen).sum())


class _Rows:
    """Recorded steps, as copies that are checked."""

    def __init__(self) -> None:
        self._rows: dict[str, list[Tensor]] = {}

    def add(self, name: str, value: Tensor, shape: tuple[int, ...]) -> None:
        if value.shape != shape:
            raise InterfaceError(f"'{name}' has shape {tuple(value.shape)}, expected {shape}")
        if not torch.isfinite(value).all():
            source = "the teacher's" if name in ("action", "scan_latent") else "the environment's"
            raise TrainingDiverged(f"{source} '{name}' holds values that are not finite")
        self._rows.setdefault(name, []).append(value.clone())

    def stacked(self) -> dict[str, Tensor]:
        return {name: torch.stack(values) for name, values in self._rows.items()}
