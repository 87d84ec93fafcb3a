"""Named observations: which number stands where, in which unit and frame."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ObsTerm:
    """One named block of an observation group; its value is `scale` times the quantity.

    Attributes:
        name: the quantity.
        size: number of columns.
        unit: unit of the quantity before scaling.
        frame: frame in which it is expressed.
        scale: factor that brings it near 1.
    """

    name: str
    size: int
    unit: str
    frame: str
    scale: float = 1.0


@dataclass(frozen=True)
class ObsLayout:
    """The groups of an observation and the terms of each, in order.

    Groups (section III-A of the paper): `proprio` is what a robot's own sensors give, `explicit` the base
    velocity, `implicit` what describes the body and its contact with the world.
    """

    proprio: tuple[ObsTerm, ...]
    explicit: tuple[ObsTerm, ...]
    implicit: tuple[ObsTerm, ...]

    @property
    def groups(self) -> dict[str, tuple[ObsTerm, ...]]:
        """Group name -> terms."""
        return {"proprio": self.proprio, "explicit": self.explicit, "implicit": self.implicit}

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
        for candidate in self.groups[group]:
            if candidate.name == term:
                return slice(start, start + candidate.size)
            start += candidate.size
        raise KeyError(f"observation group '{group}' has no term '{term}'")


def locomotion_layout(num_design: int) -> ObsLayout:
    """The observation of the locomotion task for a design space of `num_design` parameters."""
    return ObsLayout(
        proprio=(
            ObsTerm("base_angular_velocity", 3, "rad/s", "base", 0.25),
            ObsTerm("projected_gravity", 3, "1", "base"),
            ObsTerm("command", 3, "m/s, m/s, rad/s", "base"),
            ObsTerm("joint_position_error", 12, "rad", "joint"),
            ObsTerm("joint_velocity", 12, "rad/s", "joint", 0.05),
            ObsTerm("last_action", 12, "1", "joint"),
        ),
        explicit=(ObsTerm("base_linear_velocity", 3, "m/s", "base"),),
        implicit=(
            ObsTerm("design", num_design, "fraction of half the range", "body"),
            ObsTerm("mass_ratio", 1, "1", "body", 4.0),
            ObsTerm("centre_of_mass", 3, "m", "base, at the stance", 10.0),
            ObsTerm("stance_height", 1, "m", "base above ground", 4.0),
            ObsTerm("friction", 1, "1", "contact"),
            ObsTerm("joint_damping", 1, "ratio to nominal", "joint"),
        ),
    )
