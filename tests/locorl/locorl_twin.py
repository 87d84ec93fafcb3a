"""The mirror image of an environment, made by hand: swapped legs, and hips that turn the other way."""

from __future__ import annotations

import numpy as np
import torch
from locorl import (
    GoalConfig,
    LeggedEnv,
    ObservationConfig,
    PhysicsConfig,
    RandomisationConfig,
    ScanConfig,
    TaskConfig,
    TerrainConfig,
)
from locorl.env.observation import PROPRIO
from locorl.env.symmetry import Symmetry
from locorl.terrain.tile import PARKOUR

OTHER_LEG = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
HIPS_TURN = torch.tensor([-1.0, 1.0, 1.0]).repeat(4)
"""Signs where left and right hips have the same axis along x, and thighs and knees the same along y."""


def everything(history: int = 2) -> TaskConfig:
    """Every term of the observations, robots that differ in all that can, and level ground as far as they see.

    The solver converges: what it leaves undone depends on the order of the legs.
    """
    return TaskConfig(
        max_tilt=1.5,
        min_height=0.0,
        end_on_base_contact=False,
        goals=GoalConfig(),
        terrain=TerrainConfig(kinds=("hurdles",), levels=1, columns=1, tile=PARKOUR),
        observation=ObservationConfig(
            proprio=tuple(PROPRIO),
            motors=True,
            scan=ScanConfig(forward=(-0.3, 0.6), sideways=(-0.3, 0.3)),
            history=history,
            perception_period=0.02,
        ),
        randomisation=RandomisationConfig(
            payload=(0.0, 1.0),
            centre_of_mass=0.05,
            motor_strength=(0.8, 1.2),
            motor_damping=(0.8, 1.2),
            reset_joint=0.2,
            reset_velocity=0.5,
            reset_position=0.2,
            stagger=False,
        ),
        physics=PhysicsConfig(solver_iterations=50, linesearch_iterations=50),
    )


def twin(env: LeggedEnv, joint_sign: torch.Tensor = HIPS_TURN, designs: np.ndarray | None = None) -> LeggedEnv:
    """An environment in the mirror image of the state of `env`; `designs` are those of the mirrored bodies."""
    designs = np.array(env.bodies.designs) if designs is None else designs
    state = env.state_dict() | {"designs": torch.from_numpy(designs)}
    for name in ("drawn.motor_strength", "drawn.motor_damping"):
        state[name] = state[name][:, OTHER_LEG]
    state["drawn.centre_of_mass"] *= torch.tensor([1.0, -1.0, 1.0])
    state["commands.command"] *= torch.tensor([1.0, -1.0, -1.0])
    state["goals.course"][:, :, 1] *= -1.0
    image = LeggedEnv(env.factory, designs, env.task, threads=1)
    image.load_state_dict(state)
    everyone = torch.arange(env.num_envs)
    qpos, qvel = env.sim.qpos.clone(), env.sim.qvel.clone()
    # the same start for both: no warm start of the solver
    env.sim.set_state(everyone, qpos, qvel)
    qpos[:, 7:], qvel[:, 6:] = qpos[:, 7:][:, OTHER_LEG] * joint_sign, qvel[:, 6:][:, OTHER_LEG] * joint_sign
    qpos[:, :7] *= torch.tensor([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
    qvel[:, :6] *= torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    image.sim.set_state(everyone, qpos, qvel)
    return image


def largest_differences(env: LeggedEnv, image: LeggedEnv, steps: int) -> dict[str, float]:
    """Step both with mirrored actions; how far observed and mirrored observations come apart, by term.

    In units of the term's largest value among the robots.
    Robots whose episode ends are left out, and the first steps, until which the histories hold the reset.
    """
    mirror = Symmetry.of(env)
    generator = torch.Generator().manual_seed(4)
    alive = torch.ones(env.num_envs, dtype=torch.bool)
    worst: dict[str, float] = {}
    for step in range(steps):
        action = torch.randn(env.num_envs, 12, generator=generator)
        obs, _, *ends, _ = env.step(action)
        seen, _, *other_ends, _ = image.step(mirror.action(action))
        alive &= ~(ends[0] | ends[1] | other_ends[0] | other_ends[1])
        if step <= env.task.observation.history:
            continue
        expected = mirror.observation(obs)
        for group, terms in env.layout.groups.items():
            for term in terms:
                columns = env.layout.column(group, term.name)
                own, other = (values[group][alive][:, columns] for values in (expected, seen))
                gap = float((other - own).abs().max() / own.abs().max().clamp(min=1e-3))
                worst[term.name] = max(worst.get(term.name, 0.0), gap)
    assert alive.sum() >= env.num_envs // 2
    return worst
