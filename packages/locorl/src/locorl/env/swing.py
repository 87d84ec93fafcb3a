"""How fast the feet move, and how high above where they last stood."""

from __future__ import annotations

import torch
from torch import Tensor

from locorl.env.state import Stateful
from locorl.simulation.simulator import Simulator


class Swing(Stateful):
    """Follows the feet from step to step.

    A foot of an episode that has just begun has no speed yet, and no rise before it has touched something.

    Args:
        sim: the simulator.
        dt: control period, s.

    Attributes:
        speed: horizontal, (N, 4), m/s.
        rise: above where the foot last touched something, (N, 4), m, at least 0.
    """

    _state = ("_place", "_floor", "_seen", "_stood")

    def __init__(self, sim: Simulator, dt: float) -> None:
        self._sim, self._dt = sim, dt
        n, device = sim.num_envs, sim.device
        self._place = torch.zeros(n, 4, 2, device=device)
        self._floor, self.speed, self.rise = (torch.zeros(n, 4, device=device) for _ in range(3))
        self._seen = torch.zeros(n, 1, dtype=torch.bool, device=device)
        self._stood = torch.zeros(n, 4, dtype=torch.bool, device=device)

    def update(self, touching: Tensor) -> None:
        """Take in the control step that the simulator has just made; `touching` (N, 4) are the feet that stand."""
        feet = self._sim.foot_position.float()
        place, height = feet[..., :2].clone(), feet[..., 2]
        self.speed = torch.linalg.vector_norm(place - self._place, dim=2).div_(self._dt).mul_(self._seen)
        self._stood |= touching
        self._floor = torch.where(touching, height, self._floor)
        self.rise = (height - self._floor).clamp_(min=0.0).mul_(self._stood)
        self._place = place
        self._seen.fill_(True)

    def reset(self, ids: Tensor) -> None:
        """Robots `ids` stand elsewhere now."""
        self._seen[ids] = False
        self._stood[ids] = False
