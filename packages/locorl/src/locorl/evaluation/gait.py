"""How robots walk: how high they lift their feet, how far these slide, how long they stand."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from dataclasses import dataclass, fields

import mujoco
import numpy as np
import torch
from torch import Tensor

from locorl.env.legged_env import LeggedEnv
from locorl.interfaces import Array

_SWING = 2
"""Control steps in the air that make a swing; what is shorter is a contact that flickers."""
_LEAST_WAY = 0.05
"""A robot that came less far than this has no slip per metre, m."""


@dataclass(frozen=True)
class Gait:
    """How each robot walked; arrays have the shape of the robots.

    Attributes:
        clearance: highest point of a foot's sole above the ground beneath during a swing, mean over all swings of
            all feet, m; 0 if no foot ever swung.
        slip: way that a foot slides while it touches something, mean over the feet, per metre travelled: 1 for a
            robot that is dragged on all feet, infinite for one that gets nowhere. What slides is the sole below the
            centre of the foot: a round foot that rolls does not.
        duty_factor: share of the time that a foot touches something, mean over the feet; more than 0.5 walks, less
            runs.
    """

    clearance: Array
    slip: Array
    duty_factor: Array

    def reshape(self, *shape: int) -> Gait:
        """The same with arrays of another shape."""
        return Gait(*(getattr(self, field.name).reshape(shape) for field in fields(self)))


class GaitMeter:
    """Adds up what `Gait` tells, one control step after the other.

    Only swings whose lift-off and touch-down are both seen count.

    Args:
        sole: height of each foot's centre when it stands on level ground, (N, feet), m.
        dt: control period, s.
    """

    def __init__(self, sole: Tensor, dt: float) -> None:
        sole = sole.double()
        self._sole, self._dt = sole, dt
        self._feet = torch.zeros(*sole.shape, 2, dtype=torch.float64, device=sole.device)
        self._lead = torch.zeros_like(self._feet)
        self._touching, self._stood = (torch.zeros_like(sole, dtype=torch.bool) for _ in range(2))
        self._counted = torch.zeros(len(sole), dtype=torch.bool, device=sole.device)
        self._air, self._swings = (torch.zeros_like(sole, dtype=torch.long) for _ in range(2))
        self._peak = torch.full_like(sole, -torch.inf)
        self._heights = torch.zeros_like(sole)
        self._slid, self._way, self._stance, self._steps = torch.zeros(
            4, len(sole), dtype=torch.float64, device=sole.device
        )

    def add(self, feet: Tensor, rate: Tensor, ground: Tensor, touching: Tensor, way: Tensor, counted: Tensor) -> None:
        """Take in one control step.

        Args:
            feet: centres of the feet, world, (N, feet, 3), m.
            rate: angular velocity of the feet, world axes, (N, feet, 3), rad/s.
            ground: height of the ground beneath them, (N, feet), m.
            touching: feet that touch something, (N, feet) bool.
            way: way of each robot in this step, (N,), m.
            counted: robots that this step counts for, (N,) bool; one that is left out starts anew.
        """
        place, rate = feet[..., :2].double(), rate.double()
        both = counted & self._counted
        # velocity of the sole relative to the centre above it: rate x (0, 0, -sole)
        lead = torch.stack((-rate[..., 1], rate[..., 0]), dim=-1) * self._sole[..., None]
        slid = (place - self._feet + 0.5 * self._dt * (lead + self._lead)).norm(dim=-1)
        self._slid += (slid * (touching & self._touching)).mean(dim=1) * both
        self._way += way * both
        self._stance += touching.double().mean(dim=1) * counted
        self._steps += counted

        landed = touching & (self._air >= _SWING) & counted[:, None]
        self._heights += torch.where(landed, self._peak, 0.0)
        self._swings += landed
        # a foot that has not stood since the robot counts may be anywhere in its swing
        self._stood = (self._stood | touching) & counted[:, None]
        swinging = self._stood & ~touching
        self._air = torch.where(swinging, self._air + 1, 0)
        height = feet[..., 2] - ground - self._sole
        self._peak = torch.where(swinging, torch.maximum(self._peak, height), -torch.inf)
        self._feet, self._lead = place.clone(), lead  # the simulator's tensors are live
        self._touching, self._counted = touching.clone(), counted.clone()

    def gait(self) -> Gait:
        """What was added up; arrays are (N,)."""
        swings = self._swings.sum(dim=1)
        slip = torch.where(self._way > _LEAST_WAY, self._slid / self._way, torch.inf)
        clearance = self._heights.sum(dim=1) / swings.clamp(min=1)
        duty_factor = self._stance / self._steps.clamp(min=1)
        return Gait(*(values.numpy(force=True) for values in (clearance, slip, duty_factor)))


def sole_height(env: LeggedEnv, each: int = 1) -> Tensor:
    """Height of each foot's centre on level ground, (N, feet), m, of an environment that has not been reset yet.

    Such an environment's robots stand in their stances at z = 0. Of `each` robots in a row, which have the same
    body, only the first is looked at.
    """
    sites = [mujoco.mj_name2id(env.sim.model, mujoco.mjtObj.mjOBJ_SITE, name) for name in env.factory.layout.feet]
    height = [env.sim.data_of(robot).site_xpos[sites, 2] for robot in range(0, env.num_envs, each)]
    return torch.from_numpy(np.stack(height)).to(env.device).repeat_interleave(each, dim=0)
