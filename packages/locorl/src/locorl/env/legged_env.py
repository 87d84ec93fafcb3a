"""LeggedEnv: thousands of different bodies tracking velocity commands, batched in torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from locorl.env.kinematics import projected_gravity, to_base_frame, yaw_quat
from locorl.env.observation import locomotion_layout
from locorl.interfaces import Array, BodyBatch, BodyFactory
from locorl.rewards.state import StepState
from locorl.rewards.total import total_reward
from locorl.simulation.cpu import CpuSimulator
from locorl.simulation.scene import flat_scene
from locorl.tasks.task import RandomisationConfig, TaskConfig

Obs = dict[str, Tensor]


class StepInfo(NamedTuple):
    """What a step tells besides observation, reward and ends.

    Attributes:
        truncated_ids: robots whose episode was cut by time in this step, (m,).
        final_obs: their last observation of that episode, group -> (m, dim); the bootstrap needs it.
        reward_terms: mean over robots of each weighted reward term, name -> ().
        tracking_error: |v_x - command|, (N,), m/s.
        positive_work: positive joint work in this step, (N,), J.
        diverged: robots whose simulation failed in this step, (N,) bool.
        velocity: base velocity after the step, before any reset, base frame, (N, 3), m/s.
        position: base position likewise, world frame, (N, 3), m.
    """

    truncated_ids: Tensor
    final_obs: Obs
    reward_terms: dict[str, Tensor]
    tracking_error: Tensor
    positive_work: Tensor
    diverged: Tensor
    velocity: Tensor
    position: Tensor


class _Kinematics(NamedTuple):
    velocity: Tensor
    rate: Tensor
    gravity: Tensor
    q: Tensor
    qd: Tensor


class LeggedEnv:
    """N robots, each with a body of its own, on flat ground.

    `step` resets finished robots by itself: the observation that it returns belongs to the new episode
    wherever `terminated | truncated`, and `StepInfo.final_obs` keeps the last one of a truncated episode.

    Observation groups (see `layout` for terms, units, frames and scales):
        proprio (N, 45), explicit (N, 3), implicit (N, d + 7).

    Args:
        factory: makes the bodies.
        designs: one design per robot, (N, d).
        task: commands, reward, ends, randomisation, physics.
        seed: of everything random in the environment.
        threads: simulation threads; None takes every core.

    Raises:
        ValueError: a design has no stance, or the shapes do not fit the design space.
    """

    num_actions = 12

    def __init__(
        self,
        factory: BodyFactory,
        designs: Array,
        task: TaskConfig,
        seed: int = 0,
        threads: int | None = None,
    ) -> None:
        designs = np.asarray(designs, dtype=np.float64)
        if designs.ndim != 2 or designs.shape[1] != len(factory.space.names):
            raise ValueError(f"designs must be (n, {len(factory.space.names)}), got {designs.shape}")
        self.task = task
        self.factory = factory
        self.num_envs = len(designs)
        self.device = torch.device("cpu")
        self.dt = task.physics.control_dt
        self.bodies: BodyBatch = factory.batch(designs, flat_scene(task.physics))
        if not self.bodies.feasible.all():
            bad = int(np.flatnonzero(~self.bodies.feasible)[0])
            raise ValueError(f"robot {bad} with design {designs[bad]} has no stance; sample feasible designs")
        self.generator = torch.Generator().manual_seed(seed)

        friction = self._uniform(task.randomisation.friction)
        damping = self._uniform(task.randomisation.joint_damping)
        self.sim = CpuSimulator(
            self.bodies, task.physics.substeps, _contact_fields(self.bodies, friction, damping), threads
        )
        layout = factory.layout
        self._feet = [self.sim.sensor_slice(name).start for name in layout.foot_contact]
        self._links = [self.sim.sensor_slice(name).start for name in layout.link_contact]

        f32 = torch.float32
        self.stance_qpos = torch.from_numpy(np.ascontiguousarray(self.bodies.stance_qpos))
        self.stance_q = self.stance_qpos[:, 7:].to(f32)
        self.stance_ctrl = torch.from_numpy(np.ascontiguousarray(self.bodies.stance_ctrl)).to(f32)
        self.weight = torch.from_numpy(np.asarray(self.bodies.total_mass)).to(f32) * 9.81
        self.layout = locomotion_layout(designs.shape[1])
        self.group_dims: Mapping[str, int] = self.layout.dims

        n = self.num_envs
        self.command = torch.zeros(n, 3)
        self.action = torch.zeros(n, self.num_actions)
        self.episode_step = torch.zeros(n, dtype=torch.long)
        self.command_step = torch.zeros(n, dtype=torch.long)
        self._last_qd = torch.zeros(n, 12)
        self._last_torque = torch.zeros(n, 12)
        self._air_time = torch.zeros(n, 4)
        self._last_contact = torch.zeros(n, 4, dtype=torch.bool)
        self._nowhere, self._no_force = torch.zeros(n, 3), torch.zeros(n, 4, 3)
        self._place(torch.arange(n), replace(task.randomisation, reset_joint=0.0, reset_velocity=0.0))
        self._implicit = self._describe_bodies(designs, friction, damping)

    # ------------------------------------------------------------------ public

    def reset(self, seed: int | None = None) -> Obs:
        """Start every robot afresh; with `seed`, the random stream too. Returns the observation."""
        if seed is not None:
            self.generator.manual_seed(seed)
        everyone = torch.arange(self.num_envs)
        self._reset(everyone)
        if self.task.randomisation.stagger:
            self.episode_step = torch.randint(0, self.task.episode_steps, (self.num_envs,), generator=self.generator)
        return self._observe()

    def step(self, action: Tensor) -> tuple[Obs, Tensor, Tensor, Tensor, StepInfo]:
        """Advance one control period.

        Args:
            action: (N, 12); joint target = stance target + scale * clip(action).

        Returns:
            Observation (group -> (N, dim)), reward (N,), terminated (N,), truncated (N,), `StepInfo`.
        """
        task = self.task
        last_action = self.action
        self.action = action.clamp(-task.action_clip, task.action_clip)
        self.sim.ctrl[:] = self.stance_ctrl + task.action_scale * self.action
        self.sim.step()
        self.episode_step += 1

        now = self._read()
        power = self.sim.positive_work.float() / self.dt
        reward, terms = self._reward(now, last_action, power)
        terminated = self._fallen(now) | self.sim.diverged
        reward = torch.where(self.sim.diverged, torch.zeros_like(reward), reward)
        truncated = ~terminated & (self.episode_step >= task.episode_steps)
        info_velocity, info_position = now.velocity, self.sim.qpos[:, :3].float()
        tracking_error = (now.velocity[:, 0] - self.command[:, 0]).abs()

        self._push()
        self._renew_commands()
        # a push changes what the robot feels, and a resumed run must see the same
        obs = self._observe(now if task.randomisation.push <= 0.0 else None)
        truncated_ids = truncated.nonzero().flatten()
        final_obs = {group: values[truncated_ids] for group, values in obs.items()}
        done = (terminated | truncated).nonzero().flatten()
        if len(done):
            self._reset(done)
            for group, values in self._observe(rows=done).items():
                obs[group][done] = values
        info = StepInfo(
            truncated_ids=truncated_ids,
            final_obs=final_obs,
            reward_terms={name: value.mean() for name, value in terms.items()},
            tracking_error=tracking_error,
            positive_work=self.sim.positive_work.float(),
            diverged=self.sim.diverged.clone(),
            velocity=info_velocity,
            position=info_position,
        )
        return obs, reward, terminated, truncated, info

    def state_dict(self) -> dict[str, Tensor]:
        """Everything that the next step depends on, random stream included."""
        own = {name: getattr(self, name).clone() for name in _STATE}
        sim = {f"sim.{name}": value for name, value in self.sim.state_dict().items()}
        return {**own, **sim, "generator": self.generator.get_state()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> Obs:
        """Go back to a saved state and return its observation."""
        self.sim.load_state_dict({k.removeprefix("sim."): v for k, v in state.items() if k.startswith("sim.")})
        for name in _STATE:
            setattr(self, name, state[name].clone())
        self.generator.set_state(state["generator"])
        return self._observe()

    # ----------------------------------------------------------------- details

    def _uniform(self, bounds: tuple[float, float], count: int | None = None) -> Tensor:
        low, high = bounds
        return low + (high - low) * torch.rand(count or self.num_envs, generator=self.generator)

    def _describe_bodies(self, designs: Array, friction: Tensor, damping: Tensor) -> Tensor:
        space = self.factory.space
        half_range = np.maximum((np.asarray(space.high) - np.asarray(space.low)) / 2, 1e-9)
        nominal_mass = float(self.bodies.model.body_mass.sum())
        scale = {term.name: term.scale for term in self.layout.implicit}
        blocks = (
            torch.from_numpy((designs - np.asarray(space.nominal)) / half_range),
            scale["mass_ratio"] * torch.from_numpy(np.asarray(self.bodies.total_mass) / nominal_mass - 1.0)[:, None],
            scale["centre_of_mass"] * self.sim.centre_of_mass(),
            scale["stance_height"] * self.stance_qpos[:, 2:3],
            friction[:, None],
            damping[:, None],
        )
        return torch.cat([block.float() for block in blocks], dim=1)

    def _read(self, rows: Tensor | slice = slice(None)) -> _Kinematics:
        qpos, qvel = self.sim.qpos[rows].float(), self.sim.qvel[rows].float()
        quat = qpos[:, 3:7]
        return _Kinematics(
            velocity=to_base_frame(quat, qvel[:, :3]),
            rate=qvel[:, 3:6],
            gravity=projected_gravity(quat),
            q=qpos[:, 7:],
            qd=qvel[:, 6:],
        )

    def _observe(self, now: _Kinematics | None = None, rows: Tensor | slice = slice(None)) -> Obs:
        now = now or self._read(rows)
        quantity = {
            "base_angular_velocity": now.rate,
            "projected_gravity": now.gravity,
            "command": self.command[rows],
            "joint_position_error": now.q - self.stance_q[rows],
            "joint_velocity": now.qd,
            "last_action": self.action[rows],
        }
        terms = [quantity[t.name] if t.scale == 1.0 else quantity[t.name] * t.scale for t in self.layout.proprio]
        return {
            "proprio": torch.cat(terms, dim=1),
            "explicit": now.velocity.clone(),
            "implicit": self._implicit[rows],
        }

    def _reward(self, now: _Kinematics, last_action: Tensor, power: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        sensors = self.sim.sensors
        touching = sensors[:, self._feet] > 0
        contact = touching | self._last_contact
        self._air_time += self.dt
        landed = contact & (self._air_time > self.dt * 1.5)
        torque = self.sim.torque.float()
        state = StepState(
            velocity=now.velocity,
            rate=now.rate,
            command=self.command,
            q_error=now.q - self.stance_q,
            joint_acceleration=(now.qd - self._last_qd) / self.dt,
            action=self.action,
            last_action=last_action,
            torque=torque,
            last_torque=self._last_torque,
            landed_air_time=self._air_time,
            landed=landed.float(),
            colliding_links=(sensors[:, self._links] > 0).sum(dim=1).float(),
            specific_power=power / self.weight,
            velocity_world=self._nowhere,
            goal_direction=self._nowhere,
            heading_error=self._nowhere[:, 0],
            gravity=now.gravity,
            edge_feet=self._no_force[..., 0],
            foot_force=self._no_force,
        )
        result = total_reward(state, self.task.reward, self.dt)
        self._air_time = torch.where(contact, torch.zeros_like(self._air_time), self._air_time)
        self._last_contact, self._last_qd, self._last_torque = touching, now.qd, torque
        return result

    def _fallen(self, now: _Kinematics) -> Tensor:
        tilted = -now.gravity[:, 2] < float(np.cos(self.task.max_tilt))
        sunk = self.sim.qpos[:, 2] < self.task.min_height * self.stance_qpos[:, 2]
        fallen = tilted | sunk | ~now.gravity[:, 2].isfinite()
        if self.task.end_on_base_contact:
            # the sensors show the start of the last physics step, before any reset
            fallen |= (self.sim.sensors[:, self._links[0]] > 0) & (self.episode_step > 1)
        return fallen

    def _push(self) -> None:
        random = self.task.randomisation
        if random.push <= 0.0:
            return
        ids = (self.episode_step % round(random.push_interval / self.dt) == 0).nonzero().flatten()
        if len(ids):
            kick = (torch.rand(len(ids), 2, generator=self.generator) * 2 - 1) * random.push
            self.sim.qvel[ids, :2] += kick.to(self.sim.qvel.dtype)

    def _renew_commands(self) -> None:
        self.command_step += 1
        ids = (self.command_step >= round(self.task.command.hold / self.dt)).nonzero().flatten()
        if len(ids):
            self._draw_commands(ids)

    def _draw_commands(self, ids: Tensor) -> None:
        config = self.task.command
        bounds = torch.tensor((config.vx, config.vy, config.yaw_rate))
        draw = torch.rand(len(ids), 4, generator=self.generator)
        command = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) * draw[:, :3]
        self.command[ids] = command * (draw[:, 3:] >= config.standing)
        self.command_step[ids] = 0

    def _reset(self, ids: Tensor) -> None:
        self._place(ids, self.task.randomisation)
        self.action[ids] = 0.0
        self.episode_step[ids] = 0
        self._last_torque[ids] = 0.0
        self._air_time[ids] = 0.0
        self._last_contact[ids] = False
        self._draw_commands(ids)

    def _place(self, ids: Tensor, random: RandomisationConfig) -> None:
        qpos = self.stance_qpos[ids].clone()
        qvel = torch.zeros(len(ids), 18, dtype=qpos.dtype)
        if random.reset_joint > 0.0 or random.reset_velocity > 0.0:
            draw = torch.rand(len(ids), 19, generator=self.generator).to(qpos.dtype) * 2 - 1
            qpos[:, 7:] += random.reset_joint * draw[:, :12]
            qpos[:, 3:7] = yaw_quat(torch.pi * draw[:, 12])
            qvel[:, :6] = random.reset_velocity * draw[:, 13:]
            # a deviating leg may reach lower than the stance
            qpos[:, 2] += 0.3 * random.reset_joint * self.stance_qpos[ids, 2]
        self.sim.set_state(ids, qpos, qvel)
        self._last_qd[ids] = qvel[:, 6:].float()


_STATE = (
    "command",
    "action",
    "episode_step",
    "command_step",
    "_last_qd",
    "_last_torque",
    "_air_time",
    "_last_contact",
)


def _contact_fields(bodies: BodyBatch, friction: Tensor, damping: Tensor) -> dict[str, Array]:
    """Per-simulation friction of all geoms and passive damping of the 12 joints.

    Touches `geom_friction` and `dof_damping`; neither needs derived constants.
    """
    model = bodies.model
    geom_friction = np.repeat(model.geom_friction[None], len(friction), axis=0)
    # MuJoCo takes the larger friction of a pair, so both sides get the same
    geom_friction[:, :, 0] = friction.double().numpy()[:, None]
    dof_damping = np.repeat(np.asarray(model.dof_damping)[None], len(damping), axis=0)
    dof_damping[:, 6:] *= damping.double().numpy()[:, None]
    return {"geom_friction": geom_friction, "dof_damping": dof_damping}
