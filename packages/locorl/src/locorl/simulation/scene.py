"""Scenes: the ground under the robots and the solver options of the physics."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from dataclasses import dataclass

import mujoco


@dataclass(frozen=True)
class PhysicsConfig:
    """Time steps and solver of the simulation.

    The defaults are those of the `laptop` preset: 100 Hz physics under 50 Hz control.
    """

    timestep: float = 0.01
    """Physics step, s."""
    substeps: int = 2
    """Physics steps in one control step."""
    solver_iterations: int = 10
    """Newton iterations of the constraint solver at most; with 4, violent actions throw some robots into the air."""
    linesearch_iterations: int = 20
    """Line-search iterations within one Newton iteration."""
    elliptic_cone: bool = True
    """Elliptic friction cones; pyramidal ones are some 20 % faster and slightly anisotropic."""

    def __post_init__(self) -> None:
        """Refuse time steps that no simulation can run with."""
        if self.timestep <= 0 or self.substeps < 1:
            raise ValueError(f"PhysicsConfig: need timestep > 0 and substeps >= 1, got {self}")

    @property
    def control_dt(self) -> float:
        """Control period, s."""
        return self.timestep * self.substeps


def flat_scene(physics: PhysicsConfig) -> mujoco.MjSpec:
    """An infinite level floor at z = 0, with light and solver options, ready to attach a robot to."""
    spec = mujoco.MjSpec()
    spec.modelname = "flat"
    option = spec.option
    option.timestep = physics.timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if physics.elliptic_cone else mujoco.mjtCone.mjCONE_PYRAMIDAL
    # dense: MuJoCo 4.0.0's sparse Newton factorisation is faulty, and nv = 18 is small
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.iterations = physics.solver_iterations
    option.ls_iterations = physics.linesearch_iterations
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.97],
        rgb2=[0.62, 0.72, 0.83],
        width=128,
        height=128,
    )
    spec.add_texture(
        name="grid",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.86, 0.87, 0.88],
        rgb2=[0.76, 0.78, 0.80],
        width=256,
        height=256,
    )
    grid = spec.add_material(name="grid", texrepeat=[2, 2], texuniform=True)
    grid.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    world = spec.worldbody
    world.add_light(
        name="sun",
        pos=[0, 0, 4],
        dir=[-0.3, 0.2, -1],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=[0.7, 0.7, 0.7],
        ambient=[0.3, 0.3, 0.3],
    )
    world.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        material="grid",
        contype=0,
        conaffinity=1,
    )
    return spec
