"""What a task is: where robots are, what they are asked to do, what they see and earn, when an episode ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from locorl.env.commands import CommandConfig
from locorl.env.depth_camera import DepthConfig
from locorl.env.goals import GoalConfig
from locorl.env.observation import ObservationConfig
from locorl.env.randomisation import RandomisationConfig
from locorl.rewards.config import RewardConfig
from locorl.simulation.scene import PhysicsConfig
from locorl.terrain.curriculum import CurriculumConfig
from locorl.terrain.map import TerrainConfig


@dataclass(frozen=True)
class TaskConfig:
    """A task; the defaults are velocity tracking on flat ground, `locomotion-flat`."""

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
    """... or sinks below this fraction of its stance height above the ground beneath; 0 leaves it out ..."""
    min_altitude: float | None = None
    """... or below this world height, as when a robot falls into a pit, m; None where there are no pits ..."""
    end_on_base_contact: bool = True
    """... or touches anything with its base, as when a robot lies down rather than walk."""
    command: CommandConfig = field(default_factory=CommandConfig)
    goals: GoalConfig | None = None
    """Waypoints to follow; None for plain velocity commands."""
    terrain: TerrainConfig = field(default_factory=TerrainConfig)
    curriculum: CurriculumConfig = field(default_factory=CurriculumConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    camera: DepthConfig | None = None
    """Depth camera; None for robots that need no eyes."""
    reward: RewardConfig = field(default_factory=RewardConfig)
    randomisation: RandomisationConfig = field(default_factory=RandomisationConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)

    def __post_init__(self) -> None:
        """Refuse episodes without a step and actions that move nothing."""
        for name in ("action_scale", "action_clip", "max_tilt"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"TaskConfig: {name} must be above 0, got {getattr(self, name)}")
        if not self.episode_steps >= 1:
            raise ValueError(
                f"TaskConfig: episode_seconds must be one control period ({self.physics.control_dt:g} s) or more, "
                f"got {self.episode_seconds}"
            )

    @property
    def interface(self) -> dict[str, object]:
        """What a policy must have been trained with to control robots on this task: name -> value."""
        return {
            "proprioception": self.observation.proprio,
            "motors": self.observation.motors,
            "scan": self.observation.scan,
            "control period, s": self.physics.control_dt,
            "action scale, rad": self.action_scale,
            "action clip": self.action_clip,
        }

    def on(self, kinds: Sequence[str], **terrain: Any) -> TaskConfig:
        """The task on these kinds of terrain: one column of the map for each, or two where two are the rule here.

        Args:
            kinds: of terrain.
            terrain: other settings of `TerrainConfig` to change.

        Raises:
            ValueError: no such map can be made.
        """
        columns = None if self.terrain.columns is None else len(kinds)
        changed = {"kinds": tuple(kinds), "columns": columns, **terrain}
        return replace(self, terrain=replace(self.terrain, **changed))

    @property
    def episode_steps(self) -> int:
        """Control steps in an episode."""
        return round(self.episode_seconds / self.physics.control_dt)
