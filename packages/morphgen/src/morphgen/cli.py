"""The `morphgen` command."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.files import replacing, write_text
from morphgen.robots import load_robot
from morphgen.simulation.mjcf import to_mjcf
from morphgen.views.dimensions import dimensions
from morphgen.views.drawing import draw_bodies

Scales = tuple[float, float, float, float]


@dataclass(frozen=True)
class Scale:
    """Write the URDF of a body whose legs are scaled by Table II, and print its dimensions."""

    scales: Scales
    """Front thigh, front shank, hind thigh, hind shank; each in [0.6, 1.4]."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """URDF file to write."""
    robot: str = "go2"
    """Built-in robot."""
    urdf: Path | None = None
    """Your own URDF with box legs, in place of a built-in robot."""
    mjcf: Path | None = None
    """Also write MJCF with free joint, servos and sensors on a flat floor."""

    def run(self) -> None:
        """Write the files."""
        factory = _load(self.robot, self.urdf)
        write_text(self.output, factory.urdf(self.scales))
        if self.mjcf is not None:
            write_text(self.mjcf, to_mjcf(factory.spec(self.scales)))
        for name, value in dimensions(factory, self.scales).items():
            quantity, unit = name.rsplit("_", 1)
            print(f"{quantity.replace('_', ' '):<20} {value:8.4f} {unit}")
        if not factory.feasible(np.array([self.scales]))[0]:
            print("this body has no sound level stance with its feet under the hips", file=sys.stderr)


@dataclass(frozen=True)
class Render:
    """Draw bodies in their stance from the side, to scale, with dimensions."""

    scales: tuple[Scales, ...]
    """Four scales a body; give several bodies one after the other to draw them side by side."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Picture to write (.png, .svg or .pdf)."""
    labels: tuple[str, ...] = ()
    """A title for each body; its scales by default."""
    robot: str = "go2"
    """Built-in robot."""
    urdf: Path | None = None
    """Your own URDF with box legs, in place of a built-in robot."""

    def run(self) -> None:
        """Write the picture."""
        factory = _load(self.robot, self.urdf)
        labels = self.labels or tuple("scales " + ", ".join(f"{s:g}" for s in body) for body in self.scales)
        figure = draw_bodies(factory, np.array(self.scales), labels)
        with replacing(self.output) as temporary:
            figure.savefig(temporary)


def _load(robot: str, urdf: Path | None) -> BodyFactory:
    if urdf is None:
        return load_robot(robot)
    return BodyFactory(urdf.stem, urdf.read_text(encoding="utf-8"), source=str(urdf))


def main(args: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    chosen = tyro.cli(Scale | Render, args=args, prog="morphgen", description=__doc__)
    try:
        chosen.run()
    except (MorphologyError, ValueError, OSError) as error:
        print(f"morphgen: {error}", file=sys.stderr)
        return 2
    return 0
