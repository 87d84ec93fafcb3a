"""n bodies reduced to what moves: a trunk and four legs of hip, thigh, shank and foot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Skeleton:
    """Geometry, mass and limits of n bodies of one robot; legs in the order FL, FR, RL, RR.

    Links joined by fixed joints are one rigid part. Every part has a frame parallel to the base frame (x forward,
    y left, z up) when all joint angles are zero: the trunk's at the base link, those of hip, thigh and shank at
    their joints, the foot's at the centre of its ball. The foot is rigid with the shank.

    Attributes:
        joint_origin: (n, 4, 4, 3) hip joint from the base, thigh joint from the hip joint, knee from the thigh
            joint, foot centre from the knee, at zero angles [m].
        link_mass: (n, 4, 4) of hip, thigh, shank (without the foot) and foot [kg].
        link_com: (n, 4, 4, 3) centres of mass in the frame of the part [m].
        link_inertia: (n, 4, 4, 3, 3) about the centre of mass [kg m^2].
        base_mass: (n,) [kg].
        base_com: (n, 3) [m].
        base_inertia: (n, 3, 3) about the centre of mass [kg m^2].
        foot_radius: (n, 4) [m].
        axis: (4, 3, 3) unit axes of hip, thigh and knee joint at zero angles.
        lower: (4, 3) joint limits [rad], -inf where there is none.
        upper: (4, 3) joint limits [rad], inf where there is none.
        effort: (4, 3) torque limits [N m].
        velocity: (4, 3) velocity limits [rad/s].
        damping: (4, 3) viscous joint friction [N m s/rad].
        friction: (4, 3) dry joint friction [N m].
    """

    joint_origin: Array
    link_mass: Array
    link_com: Array
    link_inertia: Array
    base_mass: Array
    base_com: Array
    base_inertia: Array
    foot_radius: Array
    axis: Array
    lower: Array
    upper: Array
    effort: Array
    velocity: Array
    damping: Array
    friction: Array

    @property
    def n(self) -> int:
        """Number of bodies."""
        return self.joint_origin.shape[0]

    @property
    def total_mass(self) -> Array:
        """(n,) [kg]."""
        return self.base_mass + self.link_mass.sum(axis=(1, 2))

    @property
    def segment_length(self) -> Array:
        """(n, 4, 2) distances from thigh joint to knee and from knee to foot centre, across their axes [m].

        The leg's own plane: sideways offsets, which no length scale changes, do not count.
        """
        along = self.joint_origin[:, :, 2:]
        axis = self.axis[:, 1:]
        return np.linalg.norm(along - (along * axis).sum(axis=-1, keepdims=True) * axis, axis=-1)
