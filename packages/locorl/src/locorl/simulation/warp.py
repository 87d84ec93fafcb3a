"""WarpSimulator: MuJoCo Warp on a GPU, or on Warp's own CPU device for tests."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import copy
import dataclasses
import warnings
from collections.abc import Mapping, Sequence

import mujoco
import torch
from mujoco.batch import MODEL_FIELDS
from torch import Tensor

from locorl.interfaces import Array, BodyBatch
from locorl.simulation.cpu import available_cores
from locorl.simulation.fields import batch_of, centre_of_mass, write_fields
from locorl.simulation.simulator import Simulator, check_state

try:
    import mujoco_warp as mjw
    import warp as wp
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "the 'warp' simulator needs MuJoCo Warp: pip install legged-locorl[gpu], or take the 'cpu' simulator",
        name=error.name,
    ) from error
from locorl.simulation.warp_kernels import add_work, contain_divergence, count_overflows

_OVERFLOW = {
    "contacts": mjw.OverflowType.BROADPHASE
    | mjw.OverflowType.NARROWPHASE
    | mjw.OverflowType.CCD
    | mjw.OverflowType.EPA_HORIZON
    | mjw.OverflowType.HFIELD,
    "constraints": mjw.OverflowType.NEFC | mjw.OverflowType.NJMAX_NNZ,
    "contact_sensors": mjw.OverflowType.CONTACT_MATCH,
}
_PER_WORLD = {field.name for field in dataclasses.fields(mjw.Model) if getattr(field.type, "shape", ())[:1] == ("*",)}


class WarpSimulator(Simulator):
    """N simulations as the worlds of MuJoCo Warp, in float32.

    Bodies differ in per-world model fields. MuJoCo's CPU batch holds them too and derives the constants that
    depend on them, so both simulators derive them alike; any field that Warp can vary by world may differ.

    One control period is a graph of kernels, recorded at the first step; on a GPU it runs on torch's current
    stream. Sums have no fixed order there, so equal seeds agree to rounding only. Compiling the kernels takes a
    minute or more, once: later processes find them in Warp's cache.

    A world that diverges (NaN, or beyond MuJoCo's limit of 1e10) is put back to the model's default pose with
    zero torque and sensors at the end of the control period.

    Args:
        bodies: one body per simulation.
        substeps: physics steps per control period.
        extra_fields: further per-simulation model fields, (N, *field shape), such as friction.
        device: `cuda`, `cuda:1`, ..., or `cpu`.
        feet: names of the sites that `foot_position` shows.
        contacts: contacts per robot to reserve memory for.

    Raises:
        ValueError: Warp finds no such device, or a field cannot vary by world there.
    """

    def __init__(
        self,
        bodies: BodyBatch,
        substeps: int,
        extra_fields: Mapping[str, Array] | None = None,
        device: str = "cuda",
        feet: Sequence[str] = (),
        contacts: int = 64,
    ) -> None:
        self.num_envs = len(bodies.designs)
        self.device, self._place = _find_device(device)
        self.model = bodies.model
        self.substeps = substeps
        self.timestep = float(self.model.opt.timestep)
        self.control_dt = self.timestep * substeps
        self._contacts = contacts
        fields = {**bodies.fields, **(extra_fields or {})}
        _check_fields(fields)
        self._host = batch_of(self.model, self.num_envs, available_cores(), fields)
        self._graph: wp.Graph | None = None
        self._batched: set[str] | None = None
        with wp.ScopedDevice(self._place):
            self._upload()
            self._data = data = mjw.make_data(
                _for_warp(self.model),
                nworld=self.num_envs,
                naconmax=self.num_envs * contacts,
                njmax=_constraint_rows(self.model, contacts),
            )
            self._rate = wp.zeros_like(data.qvel)
            self._work = wp.zeros(self.num_envs, dtype=float)
            self._failed = wp.zeros(self.num_envs, dtype=bool)
            self._diverged = wp.zeros(self.num_envs, dtype=bool)
            self._masks = wp.array([int(mask) for mask in _OVERFLOW.values()], dtype=int)
            self._counts = wp.zeros((self.num_envs, len(_OVERFLOW)), dtype=int)

        self._state = {
            name: wp.to_torch(getattr(data, name)) for name in ("qpos", "qvel", "ctrl", "act", "qacc_warmstart", "time")
        }
        self.qpos, self.qvel, self.ctrl = (self._state[name] for name in ("qpos", "qvel", "ctrl"))
        self.torque = wp.to_torch(data.actuator_force)
        self.sensors = wp.to_torch(data.sensordata)
        self._sites = wp.to_torch(data.site_xpos)
        self._feet = torch.tensor(self._site_ids(feet), dtype=torch.long, device=self.device)
        self.foot_position = torch.zeros(self.num_envs, len(feet), 3, device=self.device)
        self.positive_work = wp.to_torch(self._work)
        self.diverged = wp.to_torch(self._diverged)

    def _upload(self) -> None:
        """Copy the host's per-simulation fields, derived ones included, into Warp's model."""
        fields = {name: self._host.expanded(name) for name in sorted(MODEL_FIELDS & _PER_WORLD)}
        fields = {name: values for name, values in fields.items() if values is not None}
        if self._batched is None or not self._batched.issuperset(fields):
            self._batched = set(fields)
            self._model = mjw.put_model(_for_warp(self.model), batch_sizes=dict.fromkeys(fields, self.num_envs))
            self._model.opt.warn_overflow = 0  # counted by us, not printed at each step
            self._graph = None  # it holds the addresses of the old arrays
        for name, values in fields.items():
            target = wp.to_torch(getattr(self._model, name))
            target.copy_(torch.tensor(values).reshape(target.shape))

    def step(self) -> None:
        """Advance one control period, adding up positive joint work at every physics step."""
        stream = wp.stream_from_torch(torch.cuda.current_stream(self.device)) if self._place.is_cuda else None
        if self._graph is None:
            with wp.ScopedStream(stream):
                self._period()  # compiles and loads the kernels, which a capture may not
            with wp.ScopedCapture(self._place) as capture:
                self._period()
            self._graph = capture.graph
        else:
            wp.capture_launch(self._graph, stream=stream)
        torch.index_select(self._sites, 1, self._feet, out=self.foot_position)

    def _period(self) -> None:
        data, worlds = self._data, self.num_envs
        with wp.ScopedDevice(self._place):
            data.overflow.zero_()
            self._work.zero_()
            for _ in range(self.substeps):
                # torque and rate of the same instant: MuJoCo reports the torque at the start of the step
                wp.copy(self._rate, data.qvel)
                mjw.step(self._model, data)
                wp.launch(add_work, worlds, [self._rate, data.actuator_force, self.timestep, self._work])
            wp.launch(count_overflows, (worlds, len(_OVERFLOW)), [data.overflow, self._masks, self._counts])
            wp.launch(
                contain_divergence,
                worlds,
                [
                    self._model.qpos0,
                    float(mujoco.mjMAXVAL),
                    data.qpos,
                    data.qvel,
                    data.qacc_warmstart,
                    data.actuator_force,
                    data.sensordata,
                    data.site_xpos,
                    self._work,
                    self._failed,
                    self._diverged,
                ],
            )

    def set_state(self, ids: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """See `Simulator.set_state`."""
        ids = ids.to(self.device)
        for value in self._state.values():
            value[ids] = 0.0
        self.qpos[ids] = qpos.to(self.qpos)
        self.qvel[ids] = qvel.to(self.qvel)
        wp.to_torch(self._failed)[ids] = False

    def set_fields(self, fields: Mapping[str, Array]) -> None:
        """See `Simulator.set_fields`."""
        _check_fields(fields)
        write_fields(self._host, fields)
        with wp.ScopedDevice(self._place):
            self._upload()

    @property
    def overflows(self) -> Mapping[str, int]:
        """See `Simulator.overflows`; waits for the device, and warns of an overflow."""
        counts = dict(zip(_OVERFLOW, wp.to_torch(self._counts).sum(dim=0).tolist(), strict=True))
        lost = {name: count for name, count in counts.items() if count}
        if lost:
            warnings.warn(
                f"MuJoCo Warp ran out of room and dropped contacts, control periods by kind: {lost}; "
                f"raise SimulatorConfig.contacts (now {self._contacts} per robot)",
                RuntimeWarning,
                stacklevel=2,
            )
        return counts

    def model_of(self, index: int) -> mujoco.MjModel:
        """See `Simulator.model_of`."""
        return self._host.get_model(index)

    def data_of(self, index: int) -> mujoco.MjData:
        """See `Simulator.data_of`."""
        model = self.model_of(index)
        data = mujoco.MjData(model)
        for name, values in self._state.items():
            if name != "time":
                getattr(data, name)[:] = values[index].cpu().numpy()
        data.time = float(self._state["time"][index])
        mujoco.mj_fwdPosition(model, data)
        return data

    def centre_of_mass(self) -> Tensor:
        """See `Simulator.centre_of_mass`; computed on the CPU."""
        centre = centre_of_mass(self._host, self.qpos.double().cpu().numpy())
        return torch.from_numpy(centre).to(self.qpos)

    def state_dict(self) -> dict[str, Tensor]:
        """See `Simulator.state_dict`."""
        return {name: value.clone() for name, value in self._saved().items()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """See `Simulator.load_state_dict`."""
        own = self._saved()
        check_state(state, own)
        for name, value in own.items():
            value.copy_(state[name])

    def _saved(self) -> dict[str, Tensor]:
        return {
            **self._state,
            "failed": wp.to_torch(self._failed),
            "torque": self.torque,
            "sensors": self.sensors,
            "foot_position": self.foot_position,
        }


def _find_device(name: str) -> tuple[torch.device, wp.Device]:
    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)  # else a line for each of 80 modules
    wp.init()
    device = torch.device(name)
    if device.type == "cuda" and not (torch.cuda.is_available() and wp.is_cuda_available()):
        raise ValueError(f"simulator device '{name}': torch and Warp must both see a CUDA GPU; 'cpu' always works")
    if device.type == "cuda" and device.index is None:
        device = torch.device("cuda", torch.cuda.current_device())
    return device, wp.device_from_torch(device)


def _check_fields(fields: Mapping[str, Array]) -> None:
    fixed = sorted(set(fields) - _PER_WORLD)
    if fixed:
        raise ValueError(f"fields {fixed} cannot differ between the worlds of MuJoCo Warp; take the 'cpu' simulator")


def _for_warp(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model with Warp's port of MuJoCo's own box-box contacts; its default finds others, and takes longer."""
    model = copy.copy(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    return model


def _constraint_rows(model: mujoco.MjModel, contacts: int) -> int:
    """Most constraint rows of one robot: friction and limits of all joints, and its contacts."""
    condim = int(model.geom_condim.max())
    elliptic = model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    rows = condim if elliptic or condim == 1 else 2 * (condim - 1)
    return int(model.nv + model.jnt_limited.sum()) + rows * contacts
