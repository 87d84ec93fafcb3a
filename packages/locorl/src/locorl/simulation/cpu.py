"""CpuSimulator: MuJoCo's C++ thread pool, one model, per-simulation bodies."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import torch
from mujoco.batch import SimulationError
from numpy.typing import NDArray
from torch import Tensor

from locorl.interfaces import Array, BodyBatch
from locorl.simulation.fields import batch_of, centre_of_mass, write_fields
from locorl.simulation.simulator import Simulator, check_state

_DIVERGENCE = [
    int(kind)
    for kind in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
]
_OVERFLOW = {
    "contacts": int(mujoco.mjtWarning.mjWARN_CONTACTFULL),
    "constraints": int(mujoco.mjtWarning.mjWARN_CNSTRFULL),
}


class CpuSimulator(Simulator):
    """N simulations on all cores, without a model or a file per body.

    The bodies' fields become per-simulation values of one model (`Batch.expand`), and the constants that
    MuJoCo derives from them follow (`Batch.set_const`).

    Args:
        bodies: one body per simulation.
        substeps: physics steps per control period.
        extra_fields: further per-simulation model fields, (N, *field shape), such as friction.
        threads: worker threads; None takes every core that this process may use.
        feet: names of the sites that `foot_position` shows.
    """

    def __init__(
        self,
        bodies: BodyBatch,
        substeps: int,
        extra_fields: Mapping[str, Array] | None = None,
        threads: int | None = None,
        feet: Sequence[str] = (),
    ) -> None:
        self.num_envs = len(bodies.designs)
        self.device = torch.device("cpu")
        self.model = bodies.model
        self.substeps = substeps
        self.timestep = float(self.model.opt.timestep)
        self.control_dt = self.timestep * substeps
        self.fields = {**bodies.fields, **(extra_fields or {})}
        self._batch = batch_of(self.model, self.num_envs, threads or available_cores(), self.fields)
        self._fresh = self._batch.state[0].copy()

        bind = self._batch.bind
        self._qvel = bind("qvel")
        self.qpos = torch.from_numpy(bind("qpos"))
        self.qvel = torch.from_numpy(self._qvel)
        self.ctrl = torch.from_numpy(bind("ctrl"))
        self.torque = _read_only(bind("actuator_force"))
        self.sensors = _read_only(bind("sensordata"))
        self._feet = np.array(self._site_ids(feet), dtype=np.int64)
        self._sites = bind("site_xpos") if len(feet) else np.zeros((self.num_envs, 0, 3))
        self._foot = np.zeros((self.num_envs, len(feet), 3))
        self.foot_position = torch.from_numpy(self._foot)
        self._work = np.zeros(self.num_envs)
        shape = (self.num_envs, substeps)
        self._record = {"actuator_force": np.zeros((*shape, self.model.nu)), "qvel": np.zeros((*shape, self.model.nv))}
        self._rate, self._power = np.zeros((2, *shape, self.model.nu))
        self.positive_work = torch.from_numpy(self._work)
        self.diverged = torch.zeros(self.num_envs, dtype=torch.bool)
        self._overflows = dict.fromkeys(_OVERFLOW, 0)
        self._seen = np.zeros((len(_OVERFLOW), self.num_envs), dtype=np.int32)

    def step(self) -> None:
        """Advance one control period, adding up positive joint work at every physics step."""
        self.diverged.zero_()
        # torque and rate of the same instant: MuJoCo reports the torque at the start of a step, the rate at its end
        self._rate[:, 0] = self._qvel[:, 6:]
        try:
            # one call for all steps: each call loads every simulation's body anew
            self._batch.rollout(self.substeps, record=tuple(self._record), out=self._record)
        except SimulationError as error:
            self.diverged[torch.from_numpy(np.asarray(error.ids, dtype=np.int64))] = True
        self._rate[:, 1:] = self._record["qvel"][:, :-1, 6:]
        np.multiply(self._record["actuator_force"], self._rate, out=self._power)
        np.maximum(self._power, 0.0, out=self._power)
        np.sum(self._power, axis=(1, 2), out=self._work)
        self._work *= self.timestep
        np.take(self._sites, self._feet, axis=1, out=self._foot)
        self._read_warnings()
        self._work[self.diverged.numpy()] = 0.0

    def _read_warnings(self) -> None:
        # columns of a warning: last info, count; MuJoCo zeroes the counts at each failure, `set_state` too
        counts = self._batch.warning[:, :, 1]
        self.diverged |= torch.from_numpy((counts[:, _DIVERGENCE] > 0).any(axis=1))
        for seen, (name, column) in zip(self._seen, _OVERFLOW.items(), strict=True):
            count = counts[:, column]
            self._overflows[name] += int(np.count_nonzero((count != seen) & (count > 0)))
            seen[:] = count

    @property
    def overflows(self) -> Mapping[str, int]:
        """See `Simulator.overflows`: `contacts` and `constraints` that MuJoCo's arena had no room for."""
        return dict(self._overflows)

    def set_state(self, ids: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """See `Simulator.set_state`."""
        rows = ids.numpy()
        # what `Batch.reset` does, without loading the bodies
        self._batch.state[rows] = self._fresh
        self._batch.warning[rows] = 0
        self._seen[:, rows] = 0
        self.qpos[ids] = qpos.to(self.qpos.dtype)
        self.qvel[ids] = qvel.to(self.qvel.dtype)

    def set_fields(self, fields: Mapping[str, Array]) -> None:
        """See `Simulator.set_fields`."""
        write_fields(self._batch, fields)
        self.fields = {**self.fields, **fields}

    def model_of(self, index: int) -> mujoco.MjModel:
        """See `Simulator.model_of`."""
        return self._batch.get_model(index)

    def data_of(self, index: int) -> mujoco.MjData:
        """See `Simulator.data_of`."""
        data = self._batch.get_data(index)
        mujoco.mj_fwdPosition(self.model_of(index), data)
        return data

    def centre_of_mass(self) -> Tensor:
        """See `Simulator.centre_of_mass`; runs on a batch of its own, so that training pays nothing for it."""
        batch = batch_of(self.model, self.num_envs, self._batch.nthread, self.fields)
        return torch.from_numpy(centre_of_mass(batch, self._batch.bind("qpos")))

    def state_dict(self) -> dict[str, Tensor]:
        """See `Simulator.state_dict`."""
        return {
            "state": torch.from_numpy(self._batch.state.copy()),
            "torque": self.torque.clone(),
            "sensors": self.sensors.clone(),
            "foot_position": self.foot_position.clone(),
        }

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """See `Simulator.load_state_dict`."""
        own = {
            "state": torch.from_numpy(self._batch.state),
            "torque": self.torque,
            "sensors": self.sensors,
            "foot_position": self.foot_position,
        }
        check_state(state, own)
        for name, value in own.items():
            value.copy_(state[name])
        self._batch.warning[...] = 0
        self._seen[:] = 0


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _read_only(array: NDArray[np.float64]) -> Tensor:
    """A tensor over a read-only array; torch warns of such, so the flag is lifted for the conversion."""
    array.flags.writeable = True
    tensor = torch.from_numpy(array)
    array.flags.writeable = False
    return tensor
