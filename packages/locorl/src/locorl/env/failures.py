"""Simulations that failed, counted by the body that caused them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from locorl.interfaces import Array


@dataclass(frozen=True)
class Failure:
    """How often one body's simulation failed; `design` is (d,)."""

    design: Array
    count: int


class FailureLog:
    """Counts failed simulations; the bodies may change in between."""

    def __init__(self, designs: Array, device: torch.device) -> None:
        self._past: list[Failure] = []
        self._designs = designs
        self._counts = torch.zeros(len(designs), dtype=torch.long, device=device)

    def add(self, diverged: Tensor) -> None:
        """Count robots where `diverged` (N,)."""
        self._counts += diverged

    def change_bodies(self, designs: Array) -> None:
        """Go on with other bodies (N, d)."""
        self._past = self.by_body()
        self._designs = designs
        self._counts.zero_()

    def by_body(self) -> list[Failure]:
        """Every body that failed, the worst first."""
        counts: dict[tuple[float, ...], int] = {tuple(f.design.tolist()): f.count for f in self._past}
        for i in self._counts.nonzero().flatten().tolist():
            key = tuple(np.asarray(self._designs[i]).tolist())
            counts[key] = counts.get(key, 0) + int(self._counts[i])
        found = [Failure(np.array(design), count) for design, count in counts.items()]
        return sorted(found, key=lambda failure: -failure.count)

    def report(self, names: Sequence[str], most: int = 5) -> str:
        """One line that names the bodies which failed most; empty if none did."""
        failures = self.by_body()
        if not failures:
            return ""
        total = sum(failure.count for failure in failures)
        bodies = "; ".join(
            f"{f.count} x ({', '.join(f'{name} {value:.3g}' for name, value in zip(names, f.design, strict=True))})"
            for f in failures[:most]
        )
        more = f" and {len(failures) - most} more bodies" if len(failures) > most else ""
        return f"{total} simulations failed and were restarted: {bodies}{more}"
