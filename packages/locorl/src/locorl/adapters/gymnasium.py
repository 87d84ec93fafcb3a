"""LeggedEnv as gymnasium environments: N robots as a `VectorEnv`, one robot as an `Env`.

Importing this module registers `locorl/Legged-v0`::

    import gymnasium
    import locorl.adapters.gymnasium

    env = gymnasium.make("locorl/Legged-v0", robot="go2")
    envs = gymnasium.make_vec("locorl/Legged-v0", num_envs=64, robot="lite3", task="parkour-highjump")
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from locorl.bodies.designs import sample_designs
from locorl.env.legged_env import LeggedEnv
from locorl.env.step_info import StepInfo
from locorl.interfaces import Array, BodyFactory
from locorl.providers import find_factory
from locorl.tasks import TaskConfig, make_task

try:
    import gymnasium as gym
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise ImportError("the gymnasium environments need gymnasium: pip install legged-locorl[gym]") from error

if TYPE_CHECKING:
    from locorl.play.renderer import RobotCamera

Floats: TypeAlias = NDArray[np.float32]
Bools: TypeAlias = NDArray[np.bool_]
Observation: TypeAlias = Floats | dict[str, Floats]

_INFO = ("tracking_error", "positive_work", "velocity", "position", "diverged", "success")
WIDTH, HEIGHT = 480, 360


class GymVectorEnv(VectorEnv[Observation, Floats, NDArray[Any]]):
    """N robots as a gymnasium vector environment.

    A robot whose episode ends starts the next one within the same step (`AutoresetMode.SAME_STEP`): the
    observation is then the first of the new episode, the last one of the old is `info["final_obs"][i]`. Further
    infos are those of `StepInfo` that every robot has: `tracking_error`, `positive_work`, `velocity`, `position`,
    `diverged`, `success`, each with gymnasium's mask `_name`; of an episode's last step they are in `final_info`.

    Actions are those of `LeggedEnv`, within +- the task's `action_clip`; `gymnasium.wrappers.vector.RescaleAction`
    makes them +-1. With `stagger` in the task's randomisation, first episodes are shorter.

    Args:
        env: the robots; the adapter steps and resets it.
        flat: whether an observation is one vector, the groups one after the other, instead of a dict of them.
    """

    def __init__(self, env: LeggedEnv, flat: bool = False) -> None:
        self.env, self.flat = env, flat
        self.num_envs = env.num_envs
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}
        clip = env.task.action_clip
        self.single_action_space = gym.spaces.Box(-clip, clip, (env.num_actions,), np.float32)
        groups = [(name, _unbounded(size)) for name, size in env.group_dims.items()]
        size = sum(env.group_dims.values())
        self.single_observation_space = _unbounded(size) if flat else gym.spaces.Dict(groups)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start every robot afresh; with `seed`, all else too: random stream, curriculum.

        Raises:
            ValueError: `options` are given; there are none.
        """
        if options:
            raise ValueError(f"LeggedEnv restarts all robots and knows no options, got {sorted(options)}")
        super().reset(seed=seed)
        return self._numpy(self.env.reset(seed=seed)), {}

    def step(self, actions: Floats) -> tuple[Observation, NDArray[np.float64], Bools, Bools, dict[str, Any]]:
        """Advance one control period; see `LeggedEnv.step`.

        Args:
            actions: (N, 12).

        Returns:
            Observation, reward (N,), terminated (N,), truncated (N,), infos.

        Raises:
            ValueError: the actions have another shape.
        """
        action = torch.tensor(np.asarray(actions), dtype=torch.float32, device=self.env.device)
        if action.shape != self.action_space.shape:
            raise ValueError(f"actions must be {self.action_space.shape}, got {tuple(action.shape)}")
        obs, reward, terminated, truncated, info = self.env.step(action)
        infos = self._infos(info, _array(terminated | truncated))
        return self._numpy(obs), _array(reward.double()), _array(terminated), _array(truncated), infos

    def render(self) -> None:
        """Nothing: a single robot is rendered by `GymEnv`."""

    def _infos(self, info: StepInfo, done: Bools) -> dict[str, Any]:
        values = {name: _array(getattr(info, name)) for name in _INFO}
        infos: dict[str, Any] = _masked(values, ~done)
        if done.any():
            final = self._numpy(info.final_obs)
            observations = np.full(self.num_envs, None, dtype=object)
            for row, robot in enumerate(np.flatnonzero(done)):
                observations[robot] = _row(final, row)
            infos |= _masked({"final_obs": observations}, done)
            infos |= _masked({"final_info": _masked({k: v.copy() for k, v in values.items()}, done)}, done)
        return infos

    def _numpy(self, obs: Mapping[str, Tensor]) -> Observation:
        arrays = {group: _array(values) for group, values in obs.items()}
        return np.concatenate(list(arrays.values()), axis=1) if self.flat else arrays


class GymEnv(gym.Env[Observation, Floats]):
    """One robot as a gymnasium environment; see `GymVectorEnv` for observations, actions and infos.

    Args:
        env: one robot, in a task without `stagger`.
        flat: whether an observation is one vector instead of a dict of groups.
        render_mode: `rgb_array` or None.

    Raises:
        ValueError: several robots, staggered episodes or an unknown render mode.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012

    def __init__(self, env: LeggedEnv, flat: bool = False, render_mode: str | None = None) -> None:
        if env.num_envs != 1:
            raise ValueError(f"a GymEnv is one robot, got {env.num_envs}; GymVectorEnv takes several")
        if env.task.randomisation.stagger:
            raise ValueError("a staggered first episode starts late; set stagger=False in the task's randomisation")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be None or one of {self.metadata['render_modes']}, got {render_mode!r}")
        self.env, self.render_mode = env, render_mode
        self.metadata = {**self.metadata, "render_fps": round(1.0 / env.dt)}
        self._vector = GymVectorEnv(env, flat)
        self.action_space = self._vector.single_action_space
        self.observation_space = self._vector.single_observation_space
        self._next_obs: Observation | None = None
        self._camera: RobotCamera | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see `GymVectorEnv.reset`."""
        super().reset(seed=seed)
        # at the end of an episode LeggedEnv has already started the next
        if self._next_obs is None or seed is not None or options:
            batch, _ = self._vector.reset(seed=seed, options=options)
            self._next_obs = _row(batch, 0)
        obs, self._next_obs = self._next_obs, None
        return obs, {}

    def step(self, action: Floats) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance one control period with `action` (12,); see `LeggedEnv.step`."""
        batch, reward, terminated, truncated, infos = self._vector.step(np.asarray(action)[None])
        obs = _row(batch, 0)
        if "final_obs" in infos:
            self._next_obs = obs
            obs, infos = infos["final_obs"][0], infos["final_info"]
        info = {name: infos[name][0].item() if infos[name].ndim == 1 else infos[name][0] for name in _INFO}
        return obs, float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def render(self) -> NDArray[np.uint8] | None:
        """A picture of the robot, (360, 480, 3), or None without a render mode.

        After an episode's last step it already shows the start of the next.

        Raises:
            locorl.play.errors.PlayError: there is no OpenGL here.
        """
        if self.render_mode is None:
            return None
        if self._camera is None:
            from locorl.play.renderer import RobotCamera

            self._camera = RobotCamera(self.env.sim.model_of(0), WIDTH, HEIGHT, self.env.dt)
        return self._camera.draw(_array(self.env.sim.qpos[0]), np.empty((0, 3))).copy()

    def close(self) -> None:
        """Free the renderer."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None


def make_env(
    robot: str | BodyFactory = "go2",
    design: Array | None = None,
    task: str | TaskConfig = "locomotion-flat",
    seed: int = 0,
    flat: bool = False,
    render_mode: str | None = None,
) -> GymEnv:
    """One robot, for `gymnasium.make`.

    Args:
        robot: body factory, or what `locorl.providers.find_factory` takes.
        design: its body, (d,); nominal by default.
        task: configuration, or a name that `locorl.tasks.make_task` knows; `stagger` is switched off.
        seed: of friction and damping, and of everything else until a reset with a seed.
        flat: see `GymEnv`.
        render_mode: see `GymEnv`.
    """
    factory, task = _resolve(robot, task)
    task = replace(task, randomisation=replace(task.randomisation, stagger=False))
    designs = np.atleast_2d(factory.space.nominal if design is None else design)
    return GymEnv(LeggedEnv(factory, designs, task, seed=seed, threads=1), flat, render_mode)


def make_vector_env(
    num_envs: int,
    robot: str | BodyFactory = "go2",
    designs: Array | None = None,
    task: str | TaskConfig = "locomotion-flat",
    seed: int = 0,
    flat: bool = False,
    threads: int | None = None,
) -> GymVectorEnv:
    """Many robots, for `gymnasium.make_vec`.

    Args:
        num_envs: N.
        robot: body factory, or what `locorl.providers.find_factory` takes.
        designs: their bodies, (N, d); by default drawn uniformly from the design space.
        task: configuration, or a name that `locorl.tasks.make_task` knows.
        seed: of the bodies, of friction and damping, and of everything else until a reset with a seed.
        flat: see `GymVectorEnv`.
        threads: simulation threads; None takes every core.

    Raises:
        ValueError: the number of designs is another one.
    """
    factory, task = _resolve(robot, task)
    if designs is None:
        designs = sample_designs(factory, num_envs, np.random.default_rng(seed))
    if len(designs) != num_envs:
        raise ValueError(f"{len(designs)} designs for {num_envs} robots")
    return GymVectorEnv(LeggedEnv(factory, designs, task, seed=seed, threads=threads), flat)


def _resolve(robot: str | BodyFactory, task: str | TaskConfig) -> tuple[BodyFactory, TaskConfig]:
    factory = find_factory(robot) if isinstance(robot, str) else robot
    return factory, make_task(task) if isinstance(task, str) else task


def _unbounded(size: int) -> gym.spaces.Box:
    return gym.spaces.Box(-np.inf, np.inf, (size,), np.float32)


def _array(values: Tensor) -> NDArray[Any]:
    """A copy: some tensors of the environment are live."""
    return values.cpu().numpy().copy()


def _row(obs: Observation, row: int) -> Observation:
    return {group: values[row] for group, values in obs.items()} if isinstance(obs, dict) else obs[row]


def _masked(values: Mapping[str, Any], mask: Bools) -> dict[str, Any]:
    return {**values, **{f"_{name}": mask.copy() for name in values}}


if "locorl/Legged-v0" not in gym.registry:
    gym.register("locorl/Legged-v0", f"{__name__}:make_env", vector_entry_point=f"{__name__}:make_vector_env")
