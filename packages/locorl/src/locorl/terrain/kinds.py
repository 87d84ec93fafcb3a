"""The kinds of terrain by name."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import entry_points
from types import MappingProxyType

from locorl.terrain.high_jump import high_jump, hurdles, platforms
from locorl.terrain.long_jump import long_jump
from locorl.terrain.relief import flat, hills, slope, slope_down, slope_up
from locorl.terrain.steps import steps, steps_down, steps_up
from locorl.terrain.tile import Kind
from locorl.terrain.tilted_stones import tilted_stones

KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "flat": flat,
        "hills": hills,
        "slope": slope,
        "slope_up": slope_up,
        "slope_down": slope_down,
        "steps": steps,
        "steps_up": steps_up,
        "steps_down": steps_down,
        "high_jump": high_jump,
        "hurdles": hurdles,
        "platforms": platforms,
        "long_jump": long_jump,
        "tilted_stones": tilted_stones,
    }
)
"""Kinds of terrain; `slope`, `steps` and `high_jump` draw one of the two that follow them."""

COURSES = ("high_jump", "hurdles", "platforms", "long_jump", "tilted_stones")
"""Kinds that are run from end to end, on tiles of 18 x 4 m."""


def installed_kinds() -> Mapping[str, Kind]:
    """Kinds that other installed packages bring, by the name of their entry point in group `legged.terrains`."""
    return {point.name: point.load() for point in entry_points(group="legged.terrains")}
