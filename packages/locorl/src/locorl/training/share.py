"""The part of a training that this process does."""

from __future__ import annotations

from typing import Any

import numpy as np
from torch import Tensor

from locorl.learning.distributed import Processes


class Share:
    """Equal parts of N robots for each process of a training; all of them where there is but one process.

    Args:
        num_envs: N.
        group: the processes; None if there is one.

    Attributes:
        num_envs: robots of this process.
        rows: which of the N they are.
        first: whether this process writes files and shows progress.

    Raises:
        ValueError: the robots cannot be shared out evenly.
    """

    def __init__(self, num_envs: int, group: Processes | None) -> None:
        self.group = group
        self.rank, self.size = (0, 1) if group is None else (group.rank, group.size)
        self.num_envs = num_envs if group is None else group.share(num_envs)
        self.rows = slice(self.rank * self.num_envs, (self.rank + 1) * self.num_envs)
        self.first = self.rank == 0

    def seed(self, stream: int) -> int:
        """A seed of this process's own; `stream` itself for the first."""
        return stream if self.first else int(np.random.SeedSequence((stream, self.rank)).generate_state(1)[0])

    def all(self, values: Tensor) -> Tensor:
        """The values (n, ...) of this process's robots together with those of the others, (N, ...)."""
        return values if self.group is None else self.group.all(values)

    def collect(self, content: Any) -> list[Any]:
        """What each process has, in order, at the first process; nothing at the others."""
        return [content] if self.group is None else self.group.collect(content)
