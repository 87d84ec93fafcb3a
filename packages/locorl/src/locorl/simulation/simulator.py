"""The contract of a simulator: N bodies, one control period at a time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import torch
from torch import Tensor


class Simulator(ABC):
    """Steps N simulations, each with a body of its own.

    All arrays are torch tensors on `device`. State tensors are *live*: they show the simulations' present
    state, and what is written into them is the state at the next step. With nq = 19, nv = 18:

    ==================  ============  =================================================================
    attribute           shape         meaning
    ==================  ============  =================================================================
    `qpos`              (N, 19)       base position (m, world), base quaternion (w, x, y, z), 12 joints (rad)
    `qvel`              (N, 18)       base velocity (m/s, world), base rate (rad/s, *base* frame), joints (rad/s)
    `ctrl`              (N, 12)       targets of the PD servos, rad, which act at every physics step
    `torque`            (N, 12)       joint torque, N m, at the start of the last physics step; read only
    `sensors`           (N, n)        all sensors, at the start of the last physics step; read only
    `positive_work`     (N,)          J done by the joints in the last control period: the integral of
                                      sum_j max(tau_j w_j, 0), accumulated at every physics step (eq. 10);
                                      0 where diverged
    `diverged`          (N,) bool     simulations that failed since their last `set_state`
    ==================  ============  =================================================================

    A diverged simulation must be reset with `set_state` before the next step.
    """

    num_envs: int
    device: torch.device
    control_dt: float
    qpos: Tensor
    qvel: Tensor
    ctrl: Tensor
    torque: Tensor
    sensors: Tensor
    positive_work: Tensor
    diverged: Tensor

    @abstractmethod
    def step(self) -> None:
        """Advance all simulations by one control period with the targets in `ctrl`."""

    @abstractmethod
    def set_state(self, ids: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """Put simulations `ids` (m,) into state `qpos` (m, 19), `qvel` (m, 18), forgetting solver warm starts."""

    @abstractmethod
    def sensor_slice(self, name: str) -> slice:
        """Columns of `sensors` that hold the sensor `name`.

        Raises:
            KeyError: the model has no such sensor; the message lists those that it has.
        """

    @abstractmethod
    def centre_of_mass(self) -> Tensor:
        """Centre of mass of each robot in its present pose, relative to its base, (N, 3), m, world axes."""

    @abstractmethod
    def state_dict(self) -> dict[str, Tensor]:
        """Everything that the next step depends on, as copies."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Go back to a state taken with `state_dict`; stepping on from it is bit-identical."""
