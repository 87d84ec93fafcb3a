"""`morphgen scale` and `morphgen export`: the files of one body."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from morphgen.commands.arguments import BodyArguments
from morphgen.errors import MorphologyError
from morphgen.export import export_body, export_urdf
from morphgen.factory import BodyFactory
from morphgen.files import write_text
from morphgen.simulation.mjcf import to_mjcf
from morphgen.skeleton import Array
from morphgen.views.dimensions import dimensions


@dataclass(frozen=True, kw_only=True)
class Scale(BodyArguments):
    """Write the URDF of a scaled body and print its dimensions."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """URDF file to write."""
    mjcf: Path | None = None
    """Also write MJCF with free joint, servos and sensors on a flat floor."""
    force: bool = False
    """Write the body even if it cannot stand."""
    copy_meshes: bool = False
    """Copy the meshes beside the URDF, so that the folder can be moved."""

    def run(self) -> int:
        """Write the files."""
        factory, design = self.body()
        _require_stance(factory, design, self.force)
        mjcf = "" if self.mjcf is None else to_mjcf(factory.spec(design))  # fails before anything is written
        export_urdf(factory, design, self.output, copy_meshes=self.copy_meshes)
        if self.mjcf is not None:
            write_text(self.mjcf, mjcf)
        _report(factory, design)
        return 0


@dataclass(frozen=True, kw_only=True)
class Export(BodyArguments):
    """Write a folder with everything about a body: URDF with meshes, MJCF, GLB, picture, table of parts."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write to."""
    force: bool = False
    """Write the body even if it cannot stand."""

    def run(self) -> int:
        """Write the folder."""
        factory, design = self.body()
        _require_stance(factory, design, self.force)
        for file in export_body(factory, design, self.output):
            print(file)
        _report(factory, design)
        return 0


def _require_stance(factory: BodyFactory, design: Array, force: bool) -> None:
    problems = factory.problems(design)
    if not problems:
        return
    why = f"{factory.source}: this body has no sound level stance: {'; '.join(problems)}"
    if not force:
        raise MorphologyError(f"{why}; choose other scales, or write it all the same (--force)")
    print(why, file=sys.stderr)


def _report(factory: BodyFactory, design: Array) -> None:
    for note in factory.notes:
        print(note, file=sys.stderr)
    for name, value in dimensions(factory, design).items():
        quantity, unit = name.rsplit("_", 1)
        print(f"{quantity.replace('_', ' '):<20} {value:8.4f} {unit}")
