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

    _state = ("_place", "_floor")

    def __init__(self, sim: Simulator, dt: float) -> None:
        self._sim, self._dt = sim, dt
        self._place = torch.full((sim.num_envs, 4, 2), torch.nan, device=sim.device)
        self._floor = torch.full((sim.num_envs, 4), torch.nan, device=sim.device)
        self.speed, self.rise = (torch.zeros(sim.num_envs, 4, device=sim.device) for _ in range(2))

    def update(self, touching: Tensor) -> None:
        """Take in the control step that the simulator has just made; `touching` (N, 4) are the feet that stand."""
        feet = self._sim.foot_position.float()
        place, height = feet[..., :2], feet[..., 2]
        self.speed = torch.linalg.vector_norm(place - self._place, dim=2).div_(self._dt).nan_to_num_(nan=0.0)
        self._floor = torch.where(touching, height, self._floor)
        self.rise = (height - self._floor).nan_to_num_(nan=0.0).clamp_(min=0.0)
        self._place = place.clone()

    def reset(self, ids: Tensor) -> None:
        """Robots `ids` stand elsewhere now."""
        self._place[ids] = torch.nan
        self._floor[ids] = torch.nan
