"""`morphgen render`: pictures of bodies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from morphgen.commands.arguments import RobotArguments, Scales, space_around
from morphgen.errors import MorphologyError
from morphgen.files import replacing
from morphgen.scaling.design import SCALE_NAMES
from morphgen.views.drawing import draw_bodies
from morphgen.views.scene import body_scene, export_glb


@dataclass(frozen=True, kw_only=True)
class Render(RobotArguments):
    """Draw bodies in their stance side by side, to scale, with dimensions; or one body as GLB."""

    scales: tuple[Scales, ...] = ((1.0, 1.0, 1.0, 1.0),)
    """Four scales a body; give several bodies one after the other to draw them side by side."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Picture to write (.png, .svg or .pdf), or .glb for a three-dimensional model of one body."""
    labels: tuple[str, ...] = ()
    """A title for each body; its scales by default."""

    def run(self) -> int:
        """Write the picture."""
        designs = np.array(self.scales)
        factory = self.factory(space_around(SCALE_NAMES, designs))
        if self.output.suffix == ".glb":
            if len(designs) != 1:
                raise MorphologyError(f"{self.output}: a GLB holds one body, got {len(designs)}")
            export_glb(body_scene(factory, designs[0]), self.output)
            return 0
        labels = self.labels or tuple("scales " + ", ".join(f"{s:g}" for s in body) for body in self.scales)
        figure = draw_bodies(factory, designs, labels)
        with replacing(self.output) as temporary:
            figure.savefig(temporary)
        return 0
