"""Feet and links that touch something: air time, landings, edges, forces."""

from __future__ import annotations

import torch
from torch import Tensor

from locorl.env.state import Stateful
from locorl.interfaces import Layout
from locorl.simulation.simulator import Simulator


def evenly(columns: list[int]) -> slice | list[int]:
    """A slice of evenly spaced columns, which costs no copy, or the columns themselves."""
    step = columns[1] - columns[0] if len(columns) > 1 else 1
    even = step > 0 and columns == list(range(columns[0], columns[-1] + 1, step))
    return slice(columns[0], columns[-1] + 1, step) if even else columns


class Contacts(Stateful):
    """Reads the contact sensors after each control step.

    Attributes:
        air_time: seconds that each foot has been in the air, touch-down step included, (N, 4).
        landed: feet that touched down in this step, (N, 4), bool.
        touching: feet that touch something, (N, 4), bool.
    """

    _state = ("air_time", "landed", "touching", "_contact")

    def __init__(self, sim: Simulator, layout: Layout, dt: float) -> None:
        self._sim = sim
        self._dt = dt
        feet = [sim.sensor_slice(name) for name in layout.foot_contact]
        links = [sim.sensor_slice(name).start for name in layout.link_contact]
        self._feet = evenly([columns.start for columns in feet])
        self._links = evenly(links)
        self._base = links[0]
        self._forces = [list(range(c.start + 1, c.stop)) for c in feet]
        self.has_forces = all(len(columns) == 3 for columns in self._forces)
        """Whether the feet's sensors report the net force too."""
        shape = (sim.num_envs, 4)
        self.air_time = torch.zeros(shape, device=sim.device)
        self.landed, self.touching, self._contact = (
            torch.zeros(shape, dtype=torch.bool, device=sim.device) for _ in range(3)
        )

    def update(self) -> None:
        """Take in the control step that the simulator has just made."""
        # a foot stays down until two steps in a row find it in the air: contacts flicker
        self.air_time = torch.where(self._contact, self._dt, self.air_time + self._dt)
        last, self.touching = self.touching, self._sim.sensors[:, self._feet] > 0
        self._contact = self.touching | last
        self.landed = self._contact & (self.air_time > self._dt * 1.5)

    def reset(self, ids: Tensor) -> None:
        """Start robots `ids` without a history of contacts."""
        self.air_time[ids] = 0.0
        self.touching[ids] = False
        self._contact[ids] = False

    def colliding_links(self) -> Tensor:
        """Number of links other than feet that touch something, (N,)."""
        return (self._sim.sensors[:, self._links] > 0).sum(dim=1).float()

    def base_touches(self) -> Tensor:
        """Robots whose base touches something, (N,), bool."""
        return self._sim.sensors[:, self._base] > 0

    def foot_forces(self) -> Tensor:
        """Net contact force on each foot, world axes, (N, 4, 3), N; zeros if the robot's model does not measure it."""
        if not self.has_forces:
            return torch.zeros(self._sim.num_envs, 4, 3, device=self._sim.device)
        return self._sim.sensors[:, self._forces].float()
