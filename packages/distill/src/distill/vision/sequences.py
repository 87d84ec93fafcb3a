"""The data set of a seeing student: labelled rollouts, and what the robots remembered when each began."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from distill.vision.perception import PerceptionState


@dataclass(frozen=True)
class Sequence:
    """T steps of N robots, of which C took images.

    Attributes:
        depth: images (C, N, rows, columns).
        proprio: (T, N, P), oracle headings included.
        first: (T, N) bool, steps with which an episode begins: what was remembered before is gone.
        action: the teacher's (T, N, 12).
        explicit: base velocity (T, N, 3), m/s.
        scan_latent: the teacher's (T, N, S); S is 0 where it is not wanted.
        history: windows (N, H, P) before the first step.
        memory: of the depth encoder (N, M) before it.
        queue: what was seen before it (Q, N, S + K + 1).
    """

    depth: Tensor
    proprio: Tensor
    first: Tensor
    action: Tensor
    explicit: Tensor
    scan_latent: Tensor
    history: Tensor
    memory: Tensor
    queue: Tensor

    @property
    def num_envs(self) -> int:
        """N."""
        return len(self.history)

    @property
    def perception(self) -> PerceptionState:
        """What was remembered of images before the first step."""
        return PerceptionState(self.memory, self.queue)

    def rows(self, robots: Tensor) -> Sequence:
        """The part of some robots (n,)."""
        steps = {
            name: getattr(self, name)[:, robots]
            for name in ("depth", "proprio", "first", "action", "explicit", "scan_latent", "queue")
        }
        return Sequence(**steps, history=self.history[robots], memory=self.memory[robots])


class SequenceMemory:
    """The last rollouts; samples keep the order of time within a rollout.

    Args:
        rollouts: how many.
        device: where a `state_dict` is taken to.
    """

    def __init__(self, rollouts: int, device: torch.device | str = "cpu") -> None:
        self._rollouts: deque[Sequence] = deque(maxlen=rollouts)
        self._device = device

    def add(self, sequence: Sequence) -> None:
        """Keep a rollout; the oldest one goes."""
        self._rollouts.append(sequence)

    def sample(self, robots: int) -> Sequence:
        """One of the rollouts, for up to `robots` robots, all drawn uniformly."""
        # Drawn on the CPU, whose random state is in the checkpoint.
        sequence = self._rollouts[int(torch.randint(len(self._rollouts), ()))]
        rows = torch.randperm(sequence.num_envs)[:robots]
        return sequence.rows(rows.to(sequence.proprio.device))

    def state_dict(self) -> dict[str, object]:
        """Everything needed to go on from here."""
        return {
            str(index): {field.name: getattr(sequence, field.name) for field in fields(sequence)}
            for index, sequence in enumerate(self._rollouts)
        }

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Take over a `state_dict`."""
        self._rollouts.clear()
        for table in state.values():
            assert isinstance(table, dict)
            self._rollouts.append(Sequence(**{name: value.to(self._device) for name, value in table.items()}))
