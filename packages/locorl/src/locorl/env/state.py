"""What every part of the environment shares: the robots' motion at one instant, and saving state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from locorl.env.kinematics import projected_gravity, to_base_frame, yaw_of
from locorl.simulation.simulator import Simulator


@dataclass
class Motion:
    """Base and joints of some robots at one instant.

    Attributes:
        position: of the base, world, (n, 3), m.
        quat: base -> world, (w, x, y, z), (n, 4).
        velocity_world: of the base, (n, 3), m/s.
        velocity: the same in the base frame.
        rate: angular velocity of the base, base frame, (n, 3), rad/s.
        gravity: unit vector down, base frame, (n, 3).
        q: joint angles, (n, 12), rad.
        qd: joint velocities, (n, 12), rad/s.
    """

    position: Tensor
    quat: Tensor
    velocity_world: Tensor
    velocity: Tensor
    rate: Tensor
    gravity: Tensor
    q: Tensor
    qd: Tensor

    @cached_property
    def yaw(self) -> Tensor:
        """Heading of the base's x axis, (n,), rad."""
        return yaw_of(self.quat)


def read_motion(sim: Simulator, rows: Tensor | slice = slice(None)) -> Motion:
    """The present motion of robots `rows`, single precision, as copies: the simulator's tensors are live."""
    qpos, qvel = (values[rows].to(torch.float32, copy=True) for values in (sim.qpos, sim.qvel))
    quat = qpos[:, 3:7]
    return Motion(
        position=qpos[:, :3],
        quat=quat,
        velocity_world=qvel[:, :3],
        velocity=to_base_frame(quat, qvel[:, :3]),
        rate=qvel[:, 3:6],
        gravity=projected_gravity(quat),
        q=qpos[:, 7:],
        qd=qvel[:, 6:],
    )


class Stateful:
    """A part whose next step depends on the tensors named in `_state`."""

    _state: tuple[str, ...] = ()

    def state_dict(self) -> dict[str, Tensor]:
        """Copies of the state."""
        return {name: getattr(self, name).clone() for name in self._state}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Go back to a saved state.

        Raises:
            ValueError: it was saved with another number of robots.
        """
        for name in self._state:
            mine = getattr(self, name)
            if state[name].shape != mine.shape:
                raise ValueError(f"saved '{name}' has shape {tuple(state[name].shape)}, here it is {tuple(mine.shape)}")
            mine.copy_(state[name])


def check_ranges(config: object, *names: str) -> None:
    """Refuse ranges of a configuration whose first bound is above the second; a range may be None.

    Raises:
        ValueError: naming the configuration and the range.
    """
    for name in names:
        bounds = getattr(config, name)
        if bounds is not None and not bounds[0] <= bounds[1]:
            raise ValueError(f"{type(config).__name__}: {name} must be (low, high), got {bounds}")


def uniform(bounds: tuple[float, float], size: int | tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Uniform numbers within `bounds` on the generator's device."""
    low, high = bounds
    return low + (high - low) * torch.rand(size, generator=generator, device=generator.device)
