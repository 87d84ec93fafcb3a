"""`morphgen sample`: random bodies of a design space."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.progress import track

from morphgen.commands.arguments import RobotArguments, Space, named_space
from morphgen.errors import MorphologyError
from morphgen.export import export_urdf
from morphgen.files import replacing, write_text
from morphgen.views.sheet import contact_sheet

_PICTURED = 48
"""Bodies on a contact sheet at most."""


@dataclass(frozen=True, kw_only=True)
class Sample(RobotArguments):
    """Draw random bodies that can stand, and write their designs, URDFs and a contact sheet."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write designs.csv and sheet.png to."""
    count: int = 16
    """Number of bodies."""
    space: Space = "paper"
    """Design parameters: the paper's four scales, eight scales of the single legs, or the wide space."""
    vary: tuple[str, ...] = ()
    """Design parameters by name, in place of a named space."""
    seed: int = 0
    """Of the random numbers."""
    urdfs: bool = False
    """Also write the URDF of every body."""

    def run(self) -> int:
        """Write the folder."""
        if self.count < 1:
            raise MorphologyError(f"--count must be at least 1, got {self.count}")
        space = named_space(self.space, self.vary)
        factory = self.factory(space)
        designs = factory.sample(self.count, np.random.default_rng(self.seed))
        skeleton, stance = factory.skeleton(designs), factory.stance(designs)
        self.output.mkdir(parents=True, exist_ok=True)
        text = io.StringIO()
        writer = csv.writer(text)
        writer.writerow(["body", *space.names, "total_mass_kg", "stance_hip_height_m"])
        for i, design in enumerate(designs):
            row = (float(skeleton.total_mass[i]), float(stance.hip_height[i]))
            writer.writerow([i, *map(float, design), *row])
        write_text(self.output / "designs.csv", text.getvalue())
        with replacing(self.output / "sheet.png") as temporary:
            contact_sheet(factory, designs[:_PICTURED]).savefig(temporary)
        if self.urdfs:
            digits = len(str(self.count - 1))
            for i, design in enumerate(track(designs, description="URDFs")):
                export_urdf(factory, design, self.output / f"body_{i:0{digits}}.urdf")
        print(f"{self.count} bodies of {factory.name} in {self.output}")
        return 0
