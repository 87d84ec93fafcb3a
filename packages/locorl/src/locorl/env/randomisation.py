"""Domain randomisation: what differs between robots besides the body, and what disturbs them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from locorl.env.state import Stateful, check_ranges, uniform
from locorl.interfaces import Array, BodyBatch


@dataclass(frozen=True)
class RandomisationConfig:
    """Ranges; what is drawn once per robot holds until its body changes."""

    friction: tuple[float, float] = (0.5, 1.25)
    """Sliding friction between feet and ground."""
    joint_damping: tuple[float, float] = (0.5, 2.0)
    """Factor on the joints' passive damping."""
    payload: tuple[float, float] = (0.0, 0.0)
    """Mass added at the base's centre of mass, kg."""
    centre_of_mass: float = 0.0
    """Half-width of the shift of the base's centre of mass along each axis, m."""
    motor_strength: tuple[float, float] = (1.0, 1.0)
    """Factor on each joint's proportional gain."""
    motor_damping: tuple[float, float] = (1.0, 1.0)
    """Factor on each joint's derivative gain."""
    action_delay: tuple[int, int] = (0, 0)
    """Control steps by which actions arrive late, drawn per episode, bounds included."""
    observation_noise: float = 0.0
    """Factor on the half-widths of uniform sensor noise that the observation terms state."""
    reset_joint: float = 0.1
    """Half-width of the joint angles' deviation from the stance at a reset, rad."""
    reset_velocity: float = 0.3
    """Half-width of the base's velocity at a reset, m/s and rad/s."""
    reset_position: float = 0.0
    """Half-width of the horizontal deviation from the terrain's start at a reset, m."""
    reset_yaw: float = float(np.pi)
    """Half-width of the heading's deviation at a reset that varies anything else, rad."""
    push: float = 0.0
    """Half-width of a sudden change of horizontal velocity, m/s."""
    push_interval: float = 8.0
    """Seconds between pushes."""
    stagger: bool = True
    """Whether first episodes start at random ages, so that they do not all end together."""

    def __post_init__(self) -> None:
        """Refuse delays, pushes and ranges that cannot be."""
        check_ranges(self, "friction", "joint_damping", "payload", "motor_strength", "motor_damping")
        low, high = self.action_delay
        if self.push_interval <= 0.0:
            raise ValueError(f"RandomisationConfig: push_interval must be above 0 s, got {self.push_interval}")
        if not 0 <= low <= high:
            raise ValueError(
                f"RandomisationConfig: action_delay needs 0 <= low <= high control steps, got {low}, {high}"
            )


def no_randomisation() -> RandomisationConfig:
    """Nominal friction and damping, exact stance, no disturbance: for evaluation."""
    return RandomisationConfig(
        friction=(1.0, 1.0),
        joint_damping=(1.0, 1.0),
        reset_joint=0.0,
        reset_velocity=0.0,
        stagger=False,
    )


@dataclass(frozen=True)
class Perturbation:
    """What was drawn for N robots.

    Attributes:
        friction: (N,).
        joint_damping: factor, (N,).
        payload: kg, (N,).
        centre_of_mass: shift in the base frame, (N, 3), m.
        motor_strength: factor, (N, 12).
        motor_damping: factor, (N, 12).
    """

    friction: Tensor
    joint_damping: Tensor
    payload: Tensor
    centre_of_mass: Tensor
    motor_strength: Tensor
    motor_damping: Tensor


def draw_perturbation(config: RandomisationConfig, num_envs: int, generator: torch.Generator) -> Perturbation:
    """Draw what holds for a robot as long as its body; ranges of no width take nothing from the random stream."""

    def draw(bounds: tuple[float, float], size: int | tuple[int, ...]) -> Tensor:
        if bounds[0] == bounds[1]:
            return torch.full((size,) if isinstance(size, int) else size, bounds[0], device=generator.device)
        return uniform(bounds, size, generator)

    shift = config.centre_of_mass
    return Perturbation(
        friction=uniform(config.friction, num_envs, generator),
        joint_damping=uniform(config.joint_damping, num_envs, generator),
        payload=draw(config.payload, num_envs),
        centre_of_mass=draw((-shift, shift), (num_envs, 3)),
        motor_strength=draw(config.motor_strength, (num_envs, 12)),
        motor_damping=draw(config.motor_damping, (num_envs, 12)),
    )


def perturbed_fields(bodies: BodyBatch, drawn: Perturbation, config: RandomisationConfig) -> dict[str, Array]:
    """Model fields of `bodies` that the perturbation changes, (N, ...) each, on top of the bodies' own.

    Touches `geom_friction`, `dof_damping`; where `config` varies them also `body_mass`, `body_inertia`, `body_ipos`,
    `actuator_gainprm` and `actuator_biasprm`. The simulator derives the rest.
    """
    model = bodies.model
    base = int(model.jnt_bodyid[0])

    def own(name: str) -> Array:
        if name in bodies.fields:
            return np.array(bodies.fields[name])
        return np.repeat(np.asarray(getattr(model, name))[None], len(drawn.friction), axis=0)

    def array(values: Tensor) -> Array:
        return values.double().cpu().numpy()

    # MuJoCo takes the larger friction of a pair, so both sides get the same
    friction = own("geom_friction")
    friction[:, :, 0] = array(drawn.friction)[:, None]
    damping = own("dof_damping")
    damping[:, 6:] *= array(drawn.joint_damping)[:, None]
    fields = {"geom_friction": friction, "dof_damping": damping}
    if config.payload != (0.0, 0.0):
        mass, inertia = own("body_mass"), own("body_inertia")
        loaded = mass[:, base] + array(drawn.payload)
        # a denser trunk of the same shape
        inertia[:, base] *= (loaded / mass[:, base])[:, None]
        mass[:, base] = loaded
        fields |= {"body_mass": mass, "body_inertia": inertia}
    if config.centre_of_mass > 0.0:
        centre = own("body_ipos")
        centre[:, base] += array(drawn.centre_of_mass)
        fields["body_ipos"] = centre
    if (config.motor_strength, config.motor_damping) != ((1.0, 1.0), (1.0, 1.0)):
        gain, bias = own("actuator_gainprm"), own("actuator_biasprm")
        gain[:, :, 0] *= array(drawn.motor_strength)
        bias[:, :, 1] *= array(drawn.motor_strength)
        bias[:, :, 2] *= array(drawn.motor_damping)
        fields |= {"actuator_gainprm": gain, "actuator_biasprm": bias}
    return fields


class ActionDelay(Stateful):
    """Holds actions back by a whole number of control steps, drawn per robot and episode."""

    _state = ("delay", "_past")

    def __init__(self, bounds: tuple[int, int], num_envs: int, num_actions: int, generator: torch.Generator) -> None:
        self.bounds = bounds
        self.generator = generator
        device = generator.device
        self.delay = torch.zeros(num_envs, dtype=torch.long, device=device)
        self._past = torch.zeros(num_envs, bounds[1] + 1, num_actions, device=device)
        self._everyone = torch.arange(num_envs, device=device)

    def reset(self, ids: Tensor) -> None:
        """Forget the actions of robots `ids` and draw new delays for them."""
        low, high = self.bounds
        self._past[ids] = 0.0
        device = self.generator.device
        self.delay[ids] = torch.randint(low, high + 1, (len(ids),), generator=self.generator, device=device)

    def apply(self, action: Tensor) -> Tensor:
        """Take in the newest action (N, 12) and give the one that arrives now, (N, 12)."""
        self._past = torch.cat((action[:, None], self._past[:, :-1]), dim=1)
        return self._past[self._everyone, self.delay]
