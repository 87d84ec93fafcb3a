"""`morphgen inspect`."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from morphgen.inspection.findings import Asymmetry, Inspection
from morphgen.inspection.inspect import inspect
from morphgen.urdf.legs import QUARTERS


@dataclass(frozen=True)
class Inspect:
    """Print what is in a URDF: legs, masses, meshes, asymmetries, and what was repaired or refused.

    The exit status is 0 if the robot can be scaled and 2 if not.
    """

    urdf: tyro.conf.Positional[Path]
    """The robot."""
    json: bool = False
    """Print JSON for machines."""
    mesh_path: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder in which meshes and packages are looked for; may be given several times."""
    repair: bool = False
    """Repair impossible inertias instead of refusing them."""
    lock: tuple[str, ...] = ()
    """Joints to be fixed at zero, such as those of an arm."""
    hips: tuple[str, str, str, str] | None = None
    """Hip joints of the front left, front right, rear left and rear right leg, if they are not found by place."""

    def run(self) -> int:
        """Print; returns the exit status."""
        hips: dict[str, str] | None = None
        if self.hips is not None:
            hips = dict(zip(QUARTERS, self.hips, strict=True))
        found = inspect(self.urdf, mesh_paths=self.mesh_path, repair=self.repair, lock=self.lock, hips=hips)
        if self.json:
            print(json.dumps(found.to_json(), indent=2))
        else:
            print_inspection(found, Console())
        return 0 if found.scalable else 2


def print_inspection(found: Inspection, console: Console) -> None:
    """Print an inspection as tables."""

    def say(text: str) -> None:
        console.print(text, highlight=False, soft_wrap=True)

    say(f"[bold]{escape(found.robot)}[/] {escape(found.file)}".strip())
    if found.links:
        height = "" if found.hip_height is None else f", stands with its thigh joints {found.hip_height:.3f} m high"
        say(f"{len(found.links)} links, {found.total_mass:.3f} kg{height}")
    if found.legs and found.hip_height is None:
        say("[yellow]has no sound level stance at its nominal size[/]")
    for table in (_legs(found), _links(found), _joints(found), _meshes(found)):
        if table.row_count:
            console.print(table)
    for title, names in (
        ("Shapes without <inertial>", found.missing_inertials),
        ("Collision without mass", found.collision_only),
        ("Moved, not stretched (rotors, drives, sensors)", found.carried),
    ):
        if names:
            say(f"[bold]{title}[/]: {escape(', '.join(names))}")
    for title, lines in (
        ("Left and right differ", [f"{a.part}, {a.quantity}: {_difference(a)}" for a in found.asymmetries]),
        ("Visuals without their file", [m.problem for m in found.meshes if m.problem and not m.collision]),
        ("Repaired or replaced", found.repaired),
        ("Refused", found.refused),
    ):
        if lines:
            say(f"[bold]{title}[/]")
            for line in lines:
                say(f"  {escape(line)}")
    say("[green]can be scaled[/]" if found.scalable else "[red]cannot be scaled[/]")


def _legs(found: Inspection) -> Table:
    table = _table("Legs", "leg", "hip, thigh, knee joint", "foot", *("hip", "thigh", "shank", "reach", "ball r"))
    for leg in found.legs:
        reach = f"{leg.reach[0]:.3f}-{leg.reach[1]:.3f}"
        lengths = (f"{leg.hip_offset:.3f}", f"{leg.thigh:.3f}", f"{leg.shank:.3f}", reach, f"{leg.foot_radius:.3f}")
        table.add_row(leg.name, escape("\n".join(leg.joints)), escape(leg.links[3][0]), *lengths)
    table.caption = "lengths in m" if found.legs else None
    return table


def _links(found: Inspection) -> Table:
    table = _table("Links", "link", "part", "mass kg", "centre mm", "moments kg m²", "inertia")
    for link in found.links:
        if link.mass is None or link.com is None or link.moments is None:
            numbers, state = ("", "", ""), "none"
        else:
            centre = " ".join(f"{1000 * x:.1f}" for x in link.com)
            numbers = (f"{link.mass:.4g}", centre, " ".join(f"{x:.3g}" for x in link.moments))
            state = "[red]impossible[/]" if link.problem else "valid" if any(link.moments) else "zero"
        table.add_row(escape(link.name), link.part, *numbers, state)
    return table


def _joints(found: Inspection) -> Table:
    table = _table("Joints without limits", "joint", "type", "missing")
    for joint in found.joints:
        if joint.missing:
            table.add_row(escape(joint.name), joint.kind, ", ".join(joint.missing))
    return table


def _meshes(found: Inspection) -> Table:
    table = _table("Meshes", "file", "used as", "found")
    for mesh in found.meshes:
        state = "[red]no[/]" if mesh.path is None else "yes"
        table.add_row(escape(mesh.name), "collision" if mesh.collision else "visual", state)
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _difference(found: Asymmetry) -> str:
    if math.isinf(found.difference):
        return "other shapes"
    return f"{found.difference:.3g} {found.unit}"
