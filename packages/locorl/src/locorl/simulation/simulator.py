"""The contract of a simulator: N bodies, one control period at a time."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import mujoco
import torch
from torch import Tensor

from locorl.interfaces import Array


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
    `foot_position`     (N, feet, 3)  centres of the feet, m, world, at the start of the last physics step;
                                      read only
    `positive_work`     (N,)          J done by the joints in the last control period: the integral of
                                      sum_j max(tau_j w_j, 0), accumulated at every physics step (eq. 10);
                                      0 where diverged
    `diverged`          (N,) bool     simulations that failed since their last `set_state`
    ==================  ============  =================================================================

    A diverged simulation must be reset with `set_state` before the next step.
    """

    num_envs: int
    device: torch.device
    model: mujoco.MjModel
    substeps: int
    timestep: float
    control_dt: float
    qpos: Tensor
    qvel: Tensor
    ctrl: Tensor
    torque: Tensor
    sensors: Tensor
    foot_position: Tensor
    positive_work: Tensor
    diverged: Tensor

    @abstractmethod
    def step(self) -> None:
        """Advance all simulations by one control period with the targets in `ctrl`."""

    @abstractmethod
    def set_state(self, ids: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """Put simulations `ids` (m,) into state `qpos` (m, 19), `qvel` (m, 18), forgetting solver warm starts."""

    @abstractmethod
    def set_fields(self, fields: Mapping[str, Array]) -> None:
        """Give every simulation new model fields, (N, *field shape) each, in place.

        The constants that MuJoCo derives from them follow; the state of the simulations stays. Fields that are
        not named keep their values.

        Raises:
            ValueError: no such field, it cannot differ between simulations, or its shape does not fit.
        """

    @property
    @abstractmethod
    def overflows(self) -> Mapping[str, int]:
        """How often a buffer was full since construction, so that contacts were lost: kind -> count.

        One count is one simulation in one control period. All kinds that can occur are listed, with 0 as well.
        """

    @abstractmethod
    def model_of(self, index: int) -> mujoco.MjModel:
        """The model of simulation `index` with the fields of its body, as a copy."""

    @abstractmethod
    def data_of(self, index: int) -> mujoco.MjData:
        """The present state of simulation `index` with poses and contacts computed, for its `model_of`.

        Stepping the copy on leaves the simulation alone.
        """

    @abstractmethod
    def centre_of_mass(self) -> Tensor:
        """Centre of mass of each robot in its present pose, relative to its base, (N, 3), m, world axes."""

    @abstractmethod
    def state_dict(self) -> dict[str, Tensor]:
        """Everything that the next step depends on and all that the last one showed, as copies."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Go back to a state taken with `state_dict`; stepping on from it is bit-identical.

        The bodies are not part of it: give the simulator the same ones before.

        Raises:
            ValueError: the state belongs to another number of simulations or another model.
        """

    def sensor_slice(self, name: str) -> slice:
        """Columns of `sensors` that hold the sensor `name`.

        Raises:
            KeyError: the model has no such sensor; the message lists those that it has.
        """
        sensor = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, name)
        if sensor < 0:
            known = ", ".join(self.model.sensor(i).name for i in range(self.model.nsensor))
            raise KeyError(f"the model has no sensor '{name}'; it has: {known}")
        start = int(self.model.sensor_adr[sensor])
        return slice(start, start + int(self.model.sensor_dim[sensor]))

    def _site_ids(self, names: Sequence[str]) -> list[int]:
        ids = [mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name) for name in names]
        for name, site in zip(names, ids, strict=True):
            if site < 0:
                known = ", ".join(self.model.site(i).name for i in range(self.model.nsite))
                raise KeyError(f"the model has no site '{name}' for a foot; it has: {known}")
        return ids


def check_state(state: Mapping[str, Tensor], own: Mapping[str, Tensor]) -> None:
    """Refuse a saved simulator state whose names or shapes differ from `own`.

    Raises:
        ValueError: it was saved with another number of robots or another model.
    """
    saved, here = ({name: tuple(value.shape) for name, value in each.items()} for each in (state, own))
    if saved != here:
        raise ValueError(
            f"simulator state has shapes {saved}, this simulation {here}: "
            "it was saved with another number of robots, another model or another simulator"
        )
