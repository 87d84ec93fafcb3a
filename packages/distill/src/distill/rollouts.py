"""The data set: labelled states of the most recent rollouts, from which histories are cut out."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from distill.errors import InterfaceError


class RolloutRing:
    """A ring of the last `capacity` control steps of N robots.

    Frames are stored once; the history of a sample is gathered from the frames before it and
    zeroed before the start of its episode, which takes H times less memory than storing histories.

    Args:
        capacity: control steps that samples are drawn from.
        num_envs: N.
        history: H.
        dims: width of every stored field; "proprio" is the one with a history.
        device: where the data live.
    """

    def __init__(
        self, capacity: int, num_envs: int, history: int, dims: Mapping[str, int], device: torch.device | str
    ) -> None:
        self._capacity, self._num_envs = capacity, num_envs
        # The oldest sample needs H - 1 frames before it.
        self._size = capacity + history - 1
        self._fields = {name: torch.zeros(self._size, num_envs, dim, device=device) for name, dim in dims.items()}
        self._age = torch.zeros(self._size, num_envs, dtype=torch.int64, device=device)
        self._back = torch.arange(history - 1, -1, -1, device=device)
        self._written = 0

    def __len__(self) -> int:
        """Number of samples to draw from."""
        return min(self._written, self._capacity) * self._num_envs

    def add(self, fields: Mapping[str, Tensor], age: Tensor) -> None:
        """Append one control step.

        Args:
            fields: every field, (N, dim).
            age: (N,) int64, control steps since the episode began (0 for its first frame).

        Raises:
            InterfaceError: a field has another shape.
        """
        row = self._written % self._size
        for name, store in self._fields.items():
            if fields[name].shape != store.shape[1:]:
                raise InterfaceError(
                    f"'{name}' has shape {tuple(fields[name].shape)}, expected {tuple(store.shape[1:])}"
                )
            store[row] = fields[name]
        self._age[row] = age
        self._written += 1

    def sample(self, batch: int) -> dict[str, Tensor]:
        """Draw samples uniformly, with replacement.

        Returns:
            Every field as (batch, dim), and "history" (batch, H, P) whose last frame is the sample's own.
        """
        first = max(0, self._written - self._capacity)
        # Drawn on the CPU, whose random state is in the checkpoint.
        step = torch.randint(first, self._written, (batch,)).to(self._age.device)
        robot = torch.randint(0, self._num_envs, (batch,)).to(self._age.device)
        return self.at(step, robot)

    def at(self, step: Tensor, robot: Tensor) -> dict[str, Tensor]:
        """The samples of robots `robot` (B,) at steps `step` (B,), counted from the first one ever added."""
        row = step % self._size
        samples = {name: store[row, robot] for name, store in self._fields.items()}
        rows = (step[:, None] - self._back) % self._size
        frames = self._fields["proprio"][rows, robot[:, None]]
        other_episode = self._back > self._age[row, robot][:, None]
        samples["history"] = frames.masked_fill(other_episode.unsqueeze(-1), 0.0)
        return samples

    def state_dict(self) -> dict[str, object]:
        """Everything needed to go on from here."""
        return {"fields": self._fields, "age": self._age, "written": self._written}

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Take over a `state_dict` of a ring of the same shape."""
        fields, age, written = state["fields"], state["age"], state["written"]
        assert isinstance(fields, dict)
        assert isinstance(age, Tensor)
        assert isinstance(written, int)
        for name, store in self._fields.items():
            store.copy_(fields[name])
        self._age.copy_(age)
        self._written = written
