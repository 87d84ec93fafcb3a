"""Colours of the parts of a robot whose file gives none."""

from __future__ import annotations

Color = tuple[int, int, int, int]

PALETTE: dict[str, Color] = {
    "trunk": (74, 82, 96, 255),
    "hip": (112, 122, 137, 255),
    "thigh": (217, 222, 230, 255),
    "shank": (51, 120, 191, 255),
    "foot": (38, 40, 44, 255),
}
"""Red, green, blue and opacity, 0 to 255."""
