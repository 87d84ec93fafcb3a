"""Options that say how bodies follow from a robot and a design."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from morphgen import Rule
from morphgen.stance.gains import GainKind

from legged_codesign.robots import BodyConfig, FileConfig, SpaceName


@dataclass(frozen=True, kw_only=True)
class BodyOptions:
    """What a command about a robot's bodies takes; options from `mesh_path` on are for the path of a .urdf."""

    space: SpaceName = "legs"
    """Design space: the paper's four leg scales, or a wider one (a search then needs --from-scratch)."""
    rule: Rule | None = None
    """How thigh and shank scale; None keeps what the robot comes with."""
    gains: GainKind = "none"
    """How PD gains follow the body."""
    gain_coefficients: tuple[float, ...] = ()
    """Of --gains polynomial."""
    mesh_path: tuple[Path, ...] = ()
    """Of a .urdf: folders in which its meshes and packages are looked for."""
    repair: bool = False
    """Of a .urdf: repair impossible inertias instead of refusing them."""
    lock: tuple[str, ...] = ()
    """Of a .urdf: joints that are fixed at zero, such as those of an arm."""
    hips: tuple[str, str, str, str] | None = None
    """Of a .urdf: hip joints of the front left, front right, rear left and rear right leg, if they are not found by
    place."""
    torque_limit: float | None = None
    """Of a .urdf: torque limit of joints for which it gives none, N m."""
    kp: float | None = None
    """Of a .urdf: stiffness of the servos, N m/rad; None: by weight and height."""
    kd: float | None = None
    """Of a .urdf: damping of the servos, N m s/rad; None: by weight and height."""

    @property
    def bodies(self) -> BodyConfig:
        """What these options stand for; paths mean the same from everywhere."""
        file = FileConfig(
            mesh_paths=tuple(str(path.resolve()) for path in self.mesh_path),
            repair=self.repair,
            lock=self.lock,
            hips=self.hips or (),
            torque_limit=self.torque_limit,
            kp=self.kp,
            kd=self.kd,
        )
        return BodyConfig(self.rule, self.space, self.gains, self.gain_coefficients, file)
