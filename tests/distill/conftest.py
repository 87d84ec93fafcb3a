"""Stand-ins: a toy world whose hidden parameter shows only over time, its teacher, and a robot's data."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from distill import BundleSpec, JointSpec, ObservationTerm, Student, StudentConfig
from torch import Tensor, nn

sys.path.insert(0, str(Path(__file__).parent))  # importlib mode does not

WIDTH = 12


class ToyEnv:
    """x' = 0.8 x + action + m with a load m that is drawn anew for every episode and never shown.

    A random reference r has to be reached in one step. proprio = [x, r, last action], explicit = x[:3]
    of the step before (so it has to be remembered), implicit = m.
    """

    def __init__(self, num_envs: int = 64, episode: int = 40) -> None:
        self.num_envs, self.episode = num_envs, episode
        self.device = torch.device("cpu")
        self.group_dims = {"proprio": 3 * WIDTH, "explicit": 3, "implicit": WIDTH}
        self.generator = torch.Generator()
        self.steps = 0

    def randn(self) -> Tensor:
        return torch.randn(self.num_envs, WIDTH, generator=self.generator)

    def reset(self, seed: int | None = None) -> dict[str, Tensor]:
        if seed is not None:
            self.generator.manual_seed(seed)
        self.x, self.last, self.before = (torch.zeros(self.num_envs, WIDTH) for _ in range(3))
        self.load, self.reference = 0.5 * self.randn(), self.randn()
        self.age = torch.randint(0, self.episode, (self.num_envs,), generator=self.generator)
        return self.observe()

    def observe(self) -> dict[str, Tensor]:
        proprio = torch.cat((self.x, self.reference, self.last), dim=1)
        return {"proprio": proprio, "explicit": self.before[:, :3].clone(), "implicit": self.load.clone()}

    def step(self, action: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, dict[str, object]]:
        self.steps += 1
        self.before = self.x
        self.x = 0.8 * self.x + action + self.load
        reward = -(self.x - self.reference).square().mean(dim=1)
        self.last, self.reference = action.clone(), self.randn()
        self.age += 1
        terminated = self.x.abs().amax(dim=1) > 50.0
        truncated = (self.age >= self.episode) & ~terminated
        done = (terminated | truncated)[:, None]
        self.load = torch.where(done, 0.5 * self.randn(), self.load)
        self.x, self.last, self.before = (torch.where(done, 0.0, v) for v in (self.x, self.last, self.before))
        self.age = torch.where(done[:, 0], 0, self.age)
        return self.observe(), reward, terminated, truncated, {}


class PlainToyTeacher:
    """Knows the load: r - 0.8 x - m reaches the reference exactly."""

    def act(self, obs: dict[str, Tensor]) -> Tensor:
        x, reference = obs["proprio"][:, :WIDTH], obs["proprio"][:, WIDTH : 2 * WIDTH]
        return reference - 0.8 * x - obs["implicit"]


class ToyTeacher(PlainToyTeacher):
    """The same policy as a linear actor on [proprio, explicit, latent = m]."""

    latent_dim = WIDTH

    def __init__(self) -> None:
        eye, zero = torch.eye(WIDTH), torch.zeros(WIDTH, WIDTH)
        self.actor = nn.Linear(3 * WIDTH + 3 + WIDTH, WIDTH)
        with torch.no_grad():
            self.actor.weight.copy_(torch.cat((-0.8 * eye, eye, zero, torch.zeros(WIDTH, 3), -eye), dim=1))
            self.actor.bias.zero_()

    def latent(self, obs: dict[str, Tensor]) -> Tensor:
        return obs["implicit"]


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """Sums in a fixed order, and no fight over cores."""
    torch.set_num_threads(1)


@pytest.fixture
def make_env() -> Callable[..., ToyEnv]:
    return ToyEnv


@pytest.fixture
def teacher() -> ToyTeacher:
    return ToyTeacher()


@pytest.fixture
def plain_teacher() -> PlainToyTeacher:
    return PlainToyTeacher()


@pytest.fixture(scope="session")
def spec() -> BundleSpec:
    """A robot whose every number differs from every other, so that a mix-up shows."""
    names = [f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf")]
    joints = tuple(
        JointSpec(
            name=f"{name}_joint",
            actuator=name,
            stance=(0.0, 0.8, -1.5)[index % 3] + 0.01 * index,
            target_offset=(0.02, 0.83, -1.6)[index % 3] + 0.01 * index,
            kp=40.0 + index,
            kd=0.7 + 0.01 * index,
            torque_limit=23.7,
            lower=-2.8,
            upper=2.8,
            velocity_limit=None if index == 0 else 30.1,
        )
        for index, name in enumerate(names)
    )
    return BundleSpec(
        name="toy-walk",
        robot="toy",
        base="base",
        feet=("FL_foot", "FR_foot", "RL_foot", "RR_foot"),
        design={"front_thigh": 1.0 / 3.0, "hind_shank": 1.3},
        total_mass=15.019,
        joints=joints,
        observation=(
            ObservationTerm("turning", "base_angular_velocity", 0.25, "base", "rad/s"),
            ObservationTerm("gravity", "projected_gravity", 1.0, "base", "1"),
            ObservationTerm("command", "command", (2.0, 2.0, 0.25), "base", "m/s, m/s, rad/s"),
            ObservationTerm("joints", "joint_position_error", 1.0, "joint", "rad"),
            ObservationTerm("rates", "joint_velocity", 0.05, "joint", "rad/s"),
            ObservationTerm("action", "last_action", 1.0, "joint", "1"),
        ),
        urdf='<robot name="toy"/>',
        robot_xml='<mujoco model="toy"/>',
        scene_xml='<mujoco model="toy scene"/>',
        start_height=0.31,
        physics_dt=0.005,
        command_low=(-0.6, -0.3, -0.5),
        command_high=(1.0, 0.3, 0.5),
        action_clip=0.1,
        training={"seed": 3, "curve": [0.1, 0.2]},
        commit="0123abc",
    )


@pytest.fixture(scope="session")
def student(spec: BundleSpec) -> Student:
    """An untrained student; random weights make every input count."""
    with torch.random.fork_rng():
        torch.manual_seed(7)
        return Student(spec.proprio, StudentConfig(history=12)).eval()
