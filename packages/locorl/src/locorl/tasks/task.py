"""The locomotion task: commands, reward, ends of an episode, randomisation."""

from __future__ import annotations

from dataclasses import dataclass, field

from locorl.rewards.config import RewardConfig
from locorl.simulation.scene import PhysicsConfig


@dataclass(frozen=True)
class CommandConfig:
    """Velocity commands, drawn uniformly and held for `hold` seconds."""

    vx: tuple[float, float] = (-0.6, 1.0)
    """Forward velocity, m/s."""
    vy: tuple[float, float] = (-0.3, 0.3)
    """Sideways velocity, m/s."""
    yaw_rate: tuple[float, float] = (-0.5, 0.5)
    """Yaw rate, rad/s."""
    hold: float = 10.0
    """Seconds between two draws."""
    standing: float = 0.02
    """Share of draws that command a standstill."""


@dataclass(frozen=True)
class RandomisationConfig:
    """What differs between robots besides the body, and what disturbs them."""

    friction: tuple[float, float] = (0.5, 1.25)
    """Sliding friction between feet and ground."""
    joint_damping: tuple[float, float] = (0.5, 2.0)
    """Factor on the joints' passive damping."""
    reset_joint: float = 0.1
    """Half-width of the joint angles' deviation from the stance at a reset, rad."""
    reset_velocity: float = 0.3
    """Half-width of the base's velocity at a reset, m/s and rad/s."""
    push: float = 0.0
    """Half-width of a sudden change of horizontal velocity, m/s."""
    push_interval: float = 8.0
    """Seconds between pushes."""
    stagger: bool = True
    """Whether first episodes start at random ages, so that they do not all end together."""


def no_randomisation() -> RandomisationConfig:
    """Nominal friction and damping, exact stance, no pushes: for evaluation."""
    return RandomisationConfig((1.0, 1.0), (1.0, 1.0), 0.0, 0.0, 0.0, 8.0, stagger=False)


@dataclass(frozen=True)
class TaskConfig:
    """Velocity tracking on flat ground."""

    name: str = "locomotion-flat"
    episode_seconds: float = 20.0
    """Length of an episode, s (1000 steps)."""
    action_scale: float = 0.25
    """Joint target = stance target + action_scale * action, rad."""
    action_clip: float = 6.0
    """Actions are clipped to +- this."""
    max_tilt: float = 1.0471975511965976
    """An episode ends when the base tilts further than this, rad (60 degrees)."""
    min_height: float = 0.5
    """... or sinks below this fraction of its height in the stance ..."""
    end_on_base_contact: bool = True
    """... or touches anything, as when a robot lies down rather than walk."""
    command: CommandConfig = field(default_factory=CommandConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    randomisation: RandomisationConfig = field(default_factory=RandomisationConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)

    @property
    def episode_steps(self) -> int:
        """Control steps in an episode."""
        return round(self.episode_seconds / self.physics.control_dt)
