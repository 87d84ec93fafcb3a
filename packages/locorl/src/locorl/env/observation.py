"""Named observations: which number stands where, in which unit and frame, and what it is read from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from locorl.env.scan import ScanConfig


@dataclass(frozen=True)
class ObsTerm:
    """One named block of an observation group; its value is `scale` times the quantity.

    Attributes:
        name: the quantity.
        size: number of columns.
        unit: unit of the quantity before scaling.
        frame: frame in which it is expressed.
        scale: factor that brings it near 1.
        noise: half-width of its uniform sensor noise before scaling, at noise level 1.
        onboard: whether a robot's own sensors give it; what they do not is 0 in the history.
    """

    name: str
    size: int
    unit: str
    frame: str
    scale: float = 1.0
    noise: float = 0.0
    onboard: bool = True


PROPRIO: Mapping[str, ObsTerm] = {
    term.name: term
    for term in (
        ObsTerm("base_angular_velocity", 3, "rad/s", "base", 0.25, noise=0.2),
        ObsTerm("projected_gravity", 3, "1", "base", noise=0.05),
        ObsTerm("roll_pitch", 2, "rad", "base", noise=0.05),
        ObsTerm("heading_error", 1, "rad", "world, about the vertical", onboard=False),
        ObsTerm("next_heading_error", 1, "rad", "world, about the vertical", onboard=False),
        ObsTerm("command", 3, "m/s, m/s, rad/s", "base"),
        ObsTerm("commanded_speed", 1, "m/s", "base"),
        ObsTerm("joint_position_error", 12, "rad", "joint", noise=0.01),
        ObsTerm("joint_velocity", 12, "rad/s", "joint", 0.05, noise=1.5),
        ObsTerm("last_action", 12, "1", "joint"),
        ObsTerm("foot_contact", 4, "0 or 1, minus one half", "foot"),
    )
}
"""Terms that the group `proprio` may hold, by name."""


@dataclass(frozen=True)
class ObservationConfig:
    """What the groups of an observation hold (section III-A of the paper); the defaults are those of flat ground."""

    proprio: tuple[str, ...] = (
        "base_angular_velocity",
        "projected_gravity",
        "command",
        "joint_position_error",
        "joint_velocity",
        "last_action",
    )
    """Names of terms of `PROPRIO`, in order."""
    motors: bool = False
    """Whether the implicit group tells payload, motor strength and motor damping, which are randomised then."""
    scan: ScanConfig | None = None
    """Points of the height scan."""
    history: int = 0
    """Past frames of `proprio` in the group `history`."""
    perception_period: float = 0.1
    """Seconds between updates of scan and heading errors."""

    def __post_init__(self) -> None:
        """Refuse names that do not exist."""
        unknown = [name for name in self.proprio if name not in PROPRIO]
        if unknown:
            raise ValueError(f"ObservationConfig: no proprioceptive term {unknown}; there are {sorted(PROPRIO)}")
        if self.history < 0:
            raise ValueError(f"ObservationConfig: history must be 0 frames or more, got {self.history}")


@dataclass(frozen=True)
class ObsLayout:
    """The groups of an observation and the terms of each, in order.

    Groups (section III-A of the paper): `proprio` is what a robot's own sensors give (and the way to go),
    `explicit` the base velocity, `implicit` what describes the body and its contact with the world, `scan` the
    ground around it, `history` the past frames of `proprio`, oldest first. Empty groups are left out.
    """

    proprio: tuple[ObsTerm, ...]
    explicit: tuple[ObsTerm, ...]
    implicit: tuple[ObsTerm, ...]
    scan: tuple[ObsTerm, ...] = ()
    history: tuple[ObsTerm, ...] = ()

    @property
    def groups(self) -> dict[str, tuple[ObsTerm, ...]]:
        """Group name -> terms, of the groups that are not empty."""
        every = {
            "proprio": self.proprio,
            "explicit": self.explicit,
            "implicit": self.implicit,
            "scan": self.scan,
            "history": self.history,
        }
        return {group: terms for group, terms in every.items() if terms}

    @property
    def dims(self) -> dict[str, int]:
        """Group name -> number of columns."""
        return {group: sum(term.size for term in terms) for group, terms in self.groups.items()}

    def column(self, group: str, term: str) -> slice:
        """Columns of `term` within `group`.

        Raises:
            KeyError: the group has no such term.
        """
        start = 0
        for candidate in self.groups.get(group, ()):
            if candidate.name == term:
                return slice(start, start + candidate.size)
            start += candidate.size
        raise KeyError(f"observation group '{group}' has no term '{term}'")


def observation_layout(config: ObservationConfig, num_design: int) -> ObsLayout:
    """The layout that `config` asks for, for a design space of `num_design` parameters."""
    proprio = tuple(PROPRIO[name] for name in config.proprio)
    motors = (
        ObsTerm("payload", 1, "kg", "base", 0.3),
        ObsTerm("motor_strength", 12, "ratio to nominal, minus 1", "joint"),
        ObsTerm("motor_damping", 12, "ratio to nominal, minus 1", "joint"),
    )
    width = sum(term.size for term in proprio)
    scan = config.scan
    return ObsLayout(
        proprio=proprio,
        explicit=(ObsTerm("base_linear_velocity", 3, "m/s", "base"),),
        implicit=(
            ObsTerm("design", num_design, "fraction of half the range", "body"),
            ObsTerm("mass_ratio", 1, "1", "body", 4.0),
            ObsTerm("centre_of_mass", 3, "m", "base, at the stance", 10.0),
            ObsTerm("stance_height", 1, "m", "base above ground", 4.0),
            ObsTerm("friction", 1, "1", "contact"),
            ObsTerm("joint_damping", 1, "ratio to nominal", "joint"),
            *(motors if config.motors else ()),
        ),
        scan=() if scan is None else (ObsTerm("heights", scan.size, "m", "heading, below the stance", noise=0.1),),
        history=tuple(
            ObsTerm(f"proprio[-{age}]", width, "as proprio", "as proprio") for age in range(config.history, 0, -1)
        ),
    )
