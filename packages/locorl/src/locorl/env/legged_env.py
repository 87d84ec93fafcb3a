"""LeggedEnv: thousands of different bodies on one task, batched in torch."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from locorl.env.action import check_action
from locorl.env.commands import VelocityCommands
from locorl.env.contacts import Contacts
from locorl.env.depth_stream import DepthStream
from locorl.env.embodiment import Embodiment, make_bodies
from locorl.env.failures import FailureLog
from locorl.env.goals import Waypoints
from locorl.env.guidance import Guidance
from locorl.env.observation import observation_layout
from locorl.env.observer import Observer, Snapshot
from locorl.env.progress import Progress
from locorl.env.randomisation import ActionDelay, Perturbation, draw_perturbation
from locorl.env.reset import start_state
from locorl.env.scoring import Scoring
from locorl.env.state import Motion, Stateful, read_motion
from locorl.env.step_info import StepInfo
from locorl.interfaces import Array, BodyBatch, BodyFactory
from locorl.simulation.make import SimulatorConfig, find_device, make_simulator
from locorl.simulation.scene import flat_scene
from locorl.tasks.task import TaskConfig
from locorl.terrain.curriculum import Curriculum
from locorl.terrain.map import TerrainMap

Obs = dict[str, Tensor]


class LeggedEnv:
    """N robots, each with a body of its own, on one shared terrain.

    `step` resets finished robots by itself: the observation that it returns belongs to the new episode
    wherever `terminated | truncated`, and `StepInfo.final_obs` keeps the last one of the old.
    See `layout` for the terms, units, frames and scales of the observation groups.

    Args:
        factory: makes the bodies.
        designs: one design per robot, (N, d).
        task: terrain, commands, observations, reward, ends, randomisation, physics.
        seed: of everything random in the environment.
        threads: simulation threads on a CPU; None takes every core.
        simulator: which simulator; by default MuJoCo on the CPU.

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
        simulator: SimulatorConfig | None = None,
    ) -> None:
        self.task, self.factory = task, factory
        simulator = (simulator or SimulatorConfig()).here(threads)
        self.device = find_device(simulator)
        self.num_envs = len(designs)
        self.dt = task.physics.control_dt
        self.generator = torch.Generator(self.device).manual_seed(seed)
        self.terrain = TerrainMap(task.terrain, self.device)
        self._scene = flat_scene(task.physics)
        self.terrain.add_to(self._scene)
        level = not self.terrain.boxes and self.terrain.field is None
        self._ground = None if level else self.terrain.heights

        n, device = self.num_envs, self.device
        bodies = make_bodies(factory, designs, self._scene)
        drawn = draw_perturbation(task.randomisation, n, self.generator)
        self.body = Embodiment.of(bodies, drawn)
        self.sim = make_simulator(
            simulator, bodies, task.physics.substeps, factory.layout.feet, self.body.fields(task.randomisation)
        )
        self.layout = observation_layout(task.observation, bodies.designs.shape[1])
        self.group_dims: Mapping[str, int] = self.layout.dims
        self.failures = FailureLog(bodies.designs, device)

        self.contacts = Contacts(self.sim, factory.layout, self.dt)
        self.scoring = Scoring(task.reward, self.sim, self.terrain.heights, self.dt)
        self.commands = VelocityCommands(task.command, self.dt, n, self.generator)
        count = self.terrain.waypoints.shape[2]
        self.goals = None if task.goals is None else Waypoints(task.goals, count, self.dt, n, device)
        self.guidance = Guidance(self.commands, self.goals)
        self.progress = Progress(self.guidance, self.dt, n, device)
        ground, noise = self.terrain.heights, task.randomisation.observation_noise
        self.observer = Observer(task.observation, self.layout, ground, noise, self.dt, n, self.generator)
        self.eyes = None if task.camera is None else DepthStream(task.camera, ground, n, self.dt, self.generator)
        delay = task.randomisation.action_delay
        self._delay = None if delay[1] == 0 else ActionDelay(delay, n, self.num_actions, self.generator)

        self.action = torch.zeros(n, self.num_actions, device=device)
        self.episode_step = torch.zeros(n, dtype=torch.long, device=device)
        self._obs: Obs = {}
        # a stream of its own: on level ground there is nothing to draw
        self._tile_generator = torch.Generator(device).manual_seed(seed)
        self.curriculum = Curriculum(task.curriculum, self.terrain, n, self._tile_generator, self.body.stance_height)
        self._stand()
        self._fresh = {name: part.state_dict() for name, part in self._parts().items()}

    # ------------------------------------------------------------------ public

    @property
    def bodies(self) -> BodyBatch:
        """The robots' bodies."""
        return self.body.bodies

    @property
    def stance_qpos(self) -> Tensor:
        """Standing at the origin of level ground, (N, 19)."""
        return self.body.stance_qpos

    @property
    def stance_ctrl(self) -> Tensor:
        """Targets that hold the stance, (N, 12), rad."""
        return self.body.stance_ctrl

    @property
    def stance_q(self) -> Tensor:
        """Joint angles of the stance, (N, 12), rad."""
        return self.body.stance_q

    @property
    def weight(self) -> Tensor:
        """Of each robot, payload included, (N,), N."""
        return self.body.weight

    @property
    def command(self) -> Tensor:
        """Commanded vx, vy (m/s) and yaw rate (rad/s) in the base frame, (N, 3), live."""
        return self.commands.command

    @property
    def goal(self) -> Tensor:
        """Next waypoint of each robot, world, (N, 3), m; its own place on a task without waypoints."""
        return self.sim.qpos[:, :3].float() if self.goals is None else self.goals.ahead()

    @property
    def depth(self) -> Tensor:
        """What the depth cameras show now, (N, rows, columns).

        Raises:
            ValueError: the task has no camera.
        """
        if self.eyes is None:
            raise ValueError(f"the robots of task '{self.task.name}' have no camera; set TaskConfig.camera")
        return self.eyes.frame

    @property
    def score(self) -> Tensor:
        """Mean tracking error of each robot since its body last changed, (N,), m/s."""
        return self.progress.score()

    def reset(self, seed: int | None = None) -> Obs:
        """Start every robot afresh. Returns the observation.

        With `seed` everything that episodes have changed starts afresh too, the curriculum included: equal seeds
        give equal rollouts.
        """
        if seed is not None:
            for name, part in self._parts().items():
                part.load_state_dict(self._fresh[name])
            # after the parts: cameras bring the state of the random stream along
            self.generator.manual_seed(seed)
            self._tile_generator.manual_seed(seed)
            self.curriculum.set_hip_heights(self.body.stance_height)
        everyone = torch.arange(self.num_envs, device=self.device)
        now = self._reset(everyone)
        if self.task.randomisation.stagger:
            self.episode_step[:] = torch.randint(
                0, self.task.episode_steps, (self.num_envs,), generator=self.generator, device=self.device
            )
        self._obs = self.observer.restart(self._snapshot(now), everyone)
        return self._obs

    def reset_on(self, level: Tensor, column: Tensor) -> Obs:
        """Start every robot afresh on tiles of the map of your choice, (N,) each. Returns the observation."""
        self.curriculum.level[:], self.curriculum.column[:] = level, column
        return self.reset()

    def step(self, action: Tensor) -> tuple[Obs, Tensor, Tensor, Tensor, StepInfo]:
        """Advance one control period.

        Args:
            action: (N, 12); joint target = stance target + scale * clip(action).

        Returns:
            Observation (group -> (N, dim)), reward (N,), terminated (N,), truncated (N,), `StepInfo`.

        Raises:
            ValueError: the action has another shape, or is NaN; nothing has changed then.
        """
        task = self.task
        action = check_action(action, (self.num_envs, self.num_actions), self.device)
        last_action = self.action
        self.action = action.clamp(-task.action_clip, task.action_clip)
        arriving = self.action if self._delay is None else self._delay.apply(self.action)
        self.sim.ctrl[:] = self.body.stance_ctrl + task.action_scale * arriving
        self.sim.step()
        self.episode_step += 1

        now = read_motion(self.sim)
        self.contacts.update()
        direction = self.guidance.direction(now)
        reward, terms = self.scoring.reward(
            now, self.body, self.contacts, self.guidance, direction, self.action, last_action
        )
        diverged = self.sim.diverged.clone()
        speed, error = self.progress.add(now, direction, diverged)
        success = self.guidance.reach(now)
        terminated = self._fallen(now) | diverged
        if task.reward.fall != 0.0:
            terms["fall"] = task.reward.fall * (terminated & ~diverged)
            reward = reward + terms["fall"]
        reward = torch.where(diverged, torch.zeros_like(reward), reward)
        truncated = ~terminated & ((self.episode_step >= task.episode_steps) | success)
        self.failures.add(diverged)

        self._push()
        self.commands.renew()
        # a push changes what the robot feels, and a resumed run must see the same
        seen = self._snapshot(now if task.randomisation.push <= 0.0 else read_motion(self.sim))
        self.guidance.steer(seen.motion)
        self.observer.advance(seen)
        obs = self.observer.observe(seen)
        done = (terminated | truncated).nonzero().flatten()
        level = self.curriculum.level.clone()
        final_obs = {group: values[done] for group, values in obs.items()}
        if len(done):
            asked = self.progress.whole_way(task.episode_steps - self.episode_step)
            self.curriculum.update(done, self.progress.way[done], asked[done], success[done])
            first = self.observer.restart(self._snapshot(self._reset(done), done), done)
            for group, values in first.items():
                obs[group][done] = values
        if self.eyes is not None:
            self.eyes.step(self.sim.qpos[:, :3].float(), self.sim.qpos[:, 3:7].float())
        self._obs = obs
        info = StepInfo(
            done_ids=done,
            final_obs=final_obs,
            reward_terms=dict(zip(terms, torch.stack(tuple(terms.values())).mean(dim=1), strict=True)),
            speed=speed,
            tracking_error=error,
            positive_work=self.sim.positive_work.to(torch.float32, copy=True),
            diverged=diverged,
            velocity=now.velocity,
            position=now.position,
            success=success,
            level=level,
        )
        return obs, reward, terminated, truncated, info

    def observe(self) -> Obs:
        """The observation of the present state, whatever was written into it."""
        self._obs = self.observer.observe(self._snapshot(read_motion(self.sim)))
        return self._obs

    def set_designs(self, designs: Array) -> Obs:
        """Put other bodies (N, d) in place, without building anything anew, and start every robot afresh.

        Friction, payload and motors are drawn anew. Returns the observation.

        Raises:
            ValueError: a design has no stance, or `designs` has another shape.
        """
        if len(designs) != self.num_envs:
            raise ValueError(f"{len(designs)} designs for {self.num_envs} robots")
        bodies = make_bodies(self.factory, designs, self._scene)
        self._embody(bodies, draw_perturbation(self.task.randomisation, self.num_envs, self.generator))
        self.progress.change_bodies()
        return self.reset()

    def state_dict(self) -> dict[str, Tensor]:
        """Everything that the next step depends on: bodies, their perturbation and the random stream included."""
        state = {name: getattr(self, name).clone() for name in _STATE}
        parts = {name: part.state_dict() for name, part in self._parts().items()}
        parts |= {"sim": self.sim.state_dict(), "drawn": vars(self.body.drawn), "obs": self._obs}
        state |= {f"{part}.{name}": value.clone() for part, own in parts.items() for name, value in own.items()}
        state["designs"] = torch.from_numpy(np.array(self.bodies.designs))
        streams = {"generator": self.generator, "tile_generator": self._tile_generator}
        return {**state, **{name: stream.get_state() for name, stream in streams.items()}}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> Obs:
        """Go back to a saved state, and to the bodies that it had, and return its observation.

        Raises:
            ValueError: it was saved with another number of robots or another task; nothing has changed then.
        """
        self._check(state)
        state = {name: value.to(self.device) for name, value in state.items()}
        drawn, designs = Perturbation(**_part(state, "drawn")), state["designs"].cpu().numpy()
        same = all(torch.equal(value, getattr(self.body.drawn, name)) for name, value in vars(drawn).items())
        if not same or not np.array_equal(designs, self.bodies.designs):
            self._embody(make_bodies(self.factory, designs, self._scene), drawn)
        self.sim.load_state_dict(_part(state, "sim"))
        for name, part in self._parts().items():
            part.load_state_dict(_part(state, name))
        for name in _STATE:
            setattr(self, name, state[name].clone())
        self.generator.set_state(state["generator"].cpu())
        self._tile_generator.set_state(state["tile_generator"].cpu())
        self._obs = _part(state, "obs")
        return _part(state, "obs")

    # ----------------------------------------------------------------- details

    def _parts(self) -> dict[str, Stateful]:
        parts = {
            "commands": self.commands,
            "contacts": self.contacts,
            "scoring": self.scoring,
            "progress": self.progress,
            "observer": self.observer,
            "curriculum": self.curriculum,
            "goals": self.goals,
            "eyes": self.eyes,
            "delay": self._delay,
        }
        return {name: part for name, part in parts.items() if part is not None}

    def _check(self, state: Mapping[str, Tensor]) -> None:
        saved, here = (
            {name: tuple(value.shape) for name, value in each.items() if not name.startswith("obs.")}
            for each in (state, self.state_dict())
        )
        wrong = sorted(name for name in saved | here if saved.get(name) != here.get(name))
        if wrong:
            robots = len(state["episode_step"]) if "episode_step" in state else 0
            raise ValueError(
                f"a state of {robots} robots does not fit these {self.num_envs} robots on task '{self.task.name}': "
                f"it was saved with another number of robots, another task or another simulator ({', '.join(wrong)})"
            )

    def _embody(self, bodies: BodyBatch, drawn: Perturbation) -> None:
        """Give the robots other bodies, in the simulator too."""
        self.body = Embodiment.of(bodies, drawn)
        self.failures.change_bodies(bodies.designs)
        self.curriculum.set_hip_heights(self.body.stance_height)
        self.sim.set_fields({**bodies.fields, **self.body.fields(self.task.randomisation)})
        self._stand()

    def _stand(self) -> None:
        """Put every robot in its stance at the world's origin, and describe it there to the observer."""
        everyone = torch.arange(self.num_envs, device=self.device)
        stance = self.body.stance_qpos
        self.sim.set_state(everyone, stance, torch.zeros(len(stance), 18, dtype=stance.dtype, device=self.device))
        self.observer.implicit = self.body.describe(self.layout, self.factory.space, self.sim.centre_of_mass())

    def _snapshot(self, motion: Motion, rows: Tensor | slice = slice(None)) -> Snapshot:
        return Snapshot(
            motion=motion,
            stance_q=self.body.stance_q[rows],
            stance_height=self.body.stance_height[rows],
            command=self.command[rows],
            action=self.action[rows],
            touching=self.contacts.touching[rows],
            heading_errors=lambda: self.guidance.heading_errors(motion, rows),
        )

    def _fallen(self, now: Motion) -> Tensor:
        task = self.task
        fallen = (-now.gravity[:, 2] < math.cos(task.max_tilt)) | ~now.gravity[:, 2].isfinite()
        height = self.sim.qpos[:, 2]
        if task.min_height > 0.0:
            above = height if self._ground is None else height - self._ground.at(now.position[:, :2])
            fallen |= above < task.min_height * self.body.stance_qpos[:, 2]
        if task.min_altitude is not None:
            fallen |= height < task.min_altitude
        if task.end_on_base_contact:
            # the sensors show the start of the last physics step, before any reset
            fallen |= self.contacts.base_touches() & (self.episode_step > 1)
        return fallen

    def _push(self) -> None:
        random = self.task.randomisation
        if random.push <= 0.0:
            return
        ids = (self.episode_step % max(1, round(random.push_interval / self.dt)) == 0).nonzero().flatten()
        if len(ids):
            kick = torch.rand(len(ids), 2, generator=self.generator, device=self.device) * 2 - 1
            self.sim.qvel[ids, :2] += (kick * random.push).to(self.sim.qvel.dtype)

    def _reset(self, ids: Tensor) -> Motion:
        """Start robots `ids` (m,) afresh; their motion."""
        origin, stance = self.curriculum.place(ids), self.body.stance_qpos[ids]
        qpos, qvel = start_state(stance, origin, self._ground, self.task.randomisation, self.generator)
        self.sim.set_state(ids, qpos, qvel)
        self.scoring.reset(ids, qvel[:, 6:].float())
        self.progress.reset(ids)
        self.action[ids] = 0.0
        self.episode_step[ids] = 0
        self.contacts.reset(ids)
        self.commands.draw(ids)
        if self.goals is not None:
            self.goals.assign(ids, self.terrain.waypoints[self.curriculum.level[ids], self.curriculum.column[ids]])
        if self._delay is not None:
            self._delay.reset(ids)
        if self.eyes is not None:
            self.eyes.reset(ids, qpos[:, :3].float(), qpos[:, 3:7].float())
        now = read_motion(self.sim, ids)
        self.guidance.steer(now, ids)
        return now


_STATE = ("action", "episode_step")


def _part(state: Mapping[str, Tensor], part: str) -> dict[str, Tensor]:
    return {name.removeprefix(f"{part}."): v.clone() for name, v in state.items() if name.startswith(f"{part}.")}
