"""CpuSimulator: MuJoCo's C++ thread pool, one model, per-simulation bodies."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import os
from collections.abc import Mapping

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray
from torch import Tensor

from locorl.interfaces import Array, BodyBatch
from locorl.simulation.simulator import Simulator

_DIVERGENCE = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


class CpuSimulator(Simulator):
    """N simulations on all cores, without a model or a file per body.

    The bodies' fields become per-simulation values of one model (`Batch.expand`), and the constants that
    MuJoCo derives from them follow (`Batch.set_const`).

    Args:
        bodies: one body per simulation.
        substeps: physics steps per control period.
        extra_fields: further per-simulation model fields, (N, *field shape), such as friction.
        threads: worker threads; None takes every core that this process may use.
    """

    def __init__(
        self,
        bodies: BodyBatch,
        substeps: int,
        extra_fields: Mapping[str, Array] | None = None,
        threads: int | None = None,
    ) -> None:
        self.num_envs = len(bodies.designs)
        self.device = torch.device("cpu")
        self.model = bodies.model
        self.substeps = substeps
        self.timestep = float(self.model.opt.timestep)
        self.control_dt = self.timestep * substeps
        self.fields = {**bodies.fields, **(extra_fields or {})}
        self._threads = threads or available_cores()
        self._batch = self._make_batch(self._threads)

        bind = self._batch.bind
        self._qvel, self._torque = bind("qvel"), bind("actuator_force")
        self.qpos = torch.from_numpy(bind("qpos"))
        self.qvel = torch.from_numpy(self._qvel)
        self.ctrl = torch.from_numpy(bind("ctrl"))
        self.torque = _read_only(self._torque)
        self.sensors = _read_only(bind("sensordata"))
        self._work = np.zeros(self.num_envs)
        self._power = np.zeros((self.num_envs, self.model.nu))
        self.positive_work = torch.from_numpy(self._work)
        self.diverged = torch.zeros(self.num_envs, dtype=torch.bool)

    def _make_batch(self, threads: int) -> Batch:
        batch = Batch(self.model, self.num_envs, threads)
        for name, values in self.fields.items():
            batch.expand(name)[...] = values
        batch.set_const()
        return batch

    def step(self) -> None:
        """Advance one control period, adding up positive joint work at every physics step."""
        self.diverged.zero_()
        self._work[:] = 0.0
        for _ in range(self.substeps):
            # torque and rate of the same instant: MuJoCo reports the torque at the start of the step
            rate = self._qvel[:, 6:].copy()
            try:
                self._batch.step()
            except SimulationError as error:
                self.diverged[torch.from_numpy(np.asarray(error.ids, dtype=np.int64))] = True
            np.multiply(self._torque, rate, out=self._power)
            np.maximum(self._power, 0.0, out=self._power)
            self._work += self._power.sum(axis=1)
        self._work *= self.timestep
        self.diverged |= self._warned()
        self._work[self.diverged.numpy()] = 0.0

    def _warned(self) -> Tensor:
        """Simulations that MuJoCo found unstable since their last `set_state`, which zeroes its counters."""
        # columns of a warning: last info, count; MuJoCo restarts the count at each failure
        counts = np.asarray(self._batch.warning)[:, [int(kind) for kind in _DIVERGENCE], 1]
        return torch.from_numpy((counts > 0).any(axis=1))

    def set_state(self, ids: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """See `Simulator.set_state`."""
        rows = np.sort(ids.numpy()).astype(np.int32)  # `Batch` takes only sorted ones
        self._batch.reset(rows, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self.qpos[ids] = qpos.to(self.qpos.dtype)
        self.qvel[ids] = qvel.to(self.qvel.dtype)

    def sensor_slice(self, name: str) -> slice:
        """See `Simulator.sensor_slice`."""
        sensor = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, name)
        if sensor < 0:
            known = ", ".join(self.model.sensor(i).name for i in range(self.model.nsensor))
            raise KeyError(f"the model has no sensor '{name}'; it has: {known}")
        start = int(self.model.sensor_adr[sensor])
        return slice(start, start + int(self.model.sensor_dim[sensor]))

    def centre_of_mass(self) -> Tensor:
        """See `Simulator.centre_of_mass`; runs on a batch of its own, so that training pays nothing for it."""
        batch = self._make_batch(self._threads)
        subtree, position = batch.bind("subtree_com"), batch.bind("xpos")
        batch.bind("qpos")[...] = self._batch.bind("qpos")
        batch.forward(stage=mujoco.mjtStage.mjSTAGE_POS.value)
        base = int(self.model.jnt_bodyid[0])
        return torch.from_numpy(subtree[:, base] - position[:, base])

    def state_dict(self) -> dict[str, Tensor]:
        """See `Simulator.state_dict`."""
        return {
            "state": torch.from_numpy(self._batch.state.copy()),
            "torque": self.torque.clone(),
            "sensors": self.sensors.clone(),
        }

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """See `Simulator.load_state_dict`.

        Raises:
            ValueError: the state belongs to another number of simulations or another model.
        """
        if tuple(state["state"].shape) != self._batch.state.shape:
            raise ValueError(
                f"simulator state has shape {tuple(state['state'].shape)}, this simulation "
                f"{self._batch.state.shape}: it was saved with another number of robots or another model"
            )
        self._batch.state[...] = state["state"].numpy()
        self._batch.warning[...] = 0


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _read_only(array: NDArray[np.float64]) -> Tensor:
    """A tensor over a read-only array; torch warns of such, so the flag is lifted for the conversion."""
    array.flags.writeable = True
    tensor = torch.from_numpy(array)
    array.flags.writeable = False
    return tensor
