"""From design vectors to bodies: the class that simulators and searches hold."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from morphgen.errors import MorphologyError
from morphgen.scaling.design import SCALE_NAMES, DesignSpace
from morphgen.scaling.table2 import scale_skeleton, scale_urdf
from morphgen.simulation.batch import BodyBatch, make_batch
from morphgen.simulation.layout import make_layout
from morphgen.simulation.model import Drive, build_spec
from morphgen.stance.skeleton import Array, Skeleton, read_skeleton
from morphgen.stance.solve import Stance, solve_stance
from morphgen.urdf.legs import find_legs
from morphgen.urdf.xml import parse_urdf


class BodyFactory:
    """Makes bodies of one robot from design vectors (four leg scales, Table II of the paper).

    Attributes:
        name: the robot.
        space: its design parameters and their bounds.
        layout: names and order of joints, feet, links and sensors.
        drive: servo at every joint.
    """

    def __init__(
        self,
        name: str,
        urdf: str,
        *,
        space: DesignSpace | None = None,
        drive: Drive | None = None,
        source: str | None = None,
    ) -> None:
        """Read the robot.

        Args:
            name: the robot.
            urdf: text of its URDF, with box thighs and shanks.
            space: None for the four leg scales in [0.6, 1.4].
            drive: None for the default servo.
            source: file name for messages.

        Raises:
            MorphologyError: the URDF is not a quadruped that Table II can scale.
        """
        self.name = name
        self.space = DesignSpace.leg_scales() if space is None else space
        if self.space.names != SCALE_NAMES:
            raise MorphologyError(f"the design space must be {SCALE_NAMES}, got {self.space.names}")
        self.drive = Drive() if drive is None else drive
        self._source = source or name
        self._urdf = urdf
        root = parse_urdf(urdf, self._source)
        try:
            self._legs = find_legs(root)
            self._nominal = read_skeleton(root, self._legs)
        except MorphologyError as error:
            raise MorphologyError(f"{self._source}: {error}") from error
        self.layout = make_layout(name, self._legs, self._nominal)

    def urdf(self, design: ArrayLike) -> str:
        """The scaled URDF of one design (d,)."""
        return scale_urdf(self._urdf, self._one(design), self._source)

    def spec(self, design: ArrayLike, scene: mujoco.MjSpec | None = None) -> mujoco.MjSpec:
        """A fresh MuJoCo spec of one design (d,), made from its URDF; for export and for checking batches."""
        return build_spec(self.urdf(design), self._legs, self._nominal, self.layout, self.drive, scene)

    def batch(self, designs: ArrayLike, scene: mujoco.MjSpec | None = None) -> BodyBatch:
        """Bodies for designs (n, d) as fields of one model, without a file or a compilation per body.

        Args:
            designs: (n, d) float, each within the space.
            scene: the world to put the robot into, copied; None for a flat floor with a 5 ms time step.

        Raises:
            MorphologyError: a design out of bounds; names row and parameter.
        """
        checked = self.space.validated(designs)
        bodies = scale_skeleton(self._nominal, checked)
        model = self.spec(self.space.nominal, scene).compile()
        return make_batch(checked, model, bodies, solve_stance(bodies), self._legs, self.layout, self.drive)

    def skeleton(self, designs: ArrayLike) -> Skeleton:
        """Geometry, mass and limits of the designs (n, d) as arrays."""
        return scale_skeleton(self._nominal, self.space.validated(designs))

    def stance(self, designs: ArrayLike) -> Stance:
        """Stances of the designs (n, d)."""
        return solve_stance(self.skeleton(designs))

    def feasible(self, designs: ArrayLike) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Whether each design (n, d) has a sound level stance, (n,)."""
        return self.stance(designs).feasible

    def _one(self, design: ArrayLike) -> Array:
        checked = self.space.validated(design)
        if len(checked) != 1:
            raise MorphologyError(f"expected one design of {self.space.dim} values, got {len(checked)} designs")
        return checked[0]
