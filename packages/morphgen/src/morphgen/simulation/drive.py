"""The servo at every joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.simulation.layout import Layout
from morphgen.skeleton import Array, Skeleton

_GO2_MASS, _GO2_HIP_HEIGHT = 15.0, 0.34
"""Of the robot for which the default numbers were chosen [kg], [m]."""


@dataclass(frozen=True)
class Drive:
    """The PD servo at every joint: torque = kp (target - q) - kd dq within the joint's torque limit.

    Gains are those of the paper's Section IV; armature and friction are of the size identified on Go2.

    Attributes:
        kp: stiffness [N m/rad].
        kd: damping [N m s/rad].
        armature: reflected rotor inertia [kg m^2].
        damping: viscous joint friction where the URDF gives none [N m s/rad].
        friction: dry joint friction where the URDF gives none [N m].
        torque_limit: for joints whose URDF gives none [N m]; None refuses them.
        velocity_limit: for joints whose URDF gives none [rad/s].
    """

    kp: float = 40.0
    kd: float = 0.7
    armature: float = 0.01
    damping: float = 0.1
    friction: float = 0.1
    torque_limit: float | None = None
    velocity_limit: float = 20.0

    @classmethod
    def sized(cls, mass: float, hip_height: float, torque_limit: float | None = None) -> Drive:
        """The default servo, made for a robot of 15 kg, for one of another size by dynamic similarity.

        Torques grow with m g h, times with sqrt(h / g), inertias with m h^2.

        Args:
            mass: of the robot [kg].
            hip_height: of its thigh joints in the stance [m].
            torque_limit: see the attribute.
        """
        size = hip_height / _GO2_HIP_HEIGHT
        torque, time = mass / _GO2_MASS * size, np.sqrt(size)
        base = cls()
        return cls(
            kp=float(base.kp * torque),
            kd=float(base.kd * torque * time),
            armature=float(base.armature * torque * time**2),
            damping=float(base.damping * torque * time),
            friction=float(base.friction * torque),
            torque_limit=torque_limit,
        )

    def torque_limits(self, body: Skeleton, layout: Layout) -> Array:
        """(4, 3) torque limits [N m].

        Raises:
            MorphologyError: a joint without one, and no `torque_limit`.
        """
        unknown = np.flatnonzero(np.isinf(body.effort.ravel()))
        if self.torque_limit is None and len(unknown):
            raise MorphologyError(
                f"joint '{layout.joints[unknown[0]]}': the file gives no torque limit; add effort to its <limit> or "
                "say the motors' limit (--torque-limit, Drive(torque_limit=...))"
            )
        return np.where(np.isinf(body.effort), self.torque_limit or np.inf, body.effort)

    def velocity_limits(self, body: Skeleton) -> Array:
        """(4, 3) velocity limits [rad/s]."""
        return np.where(np.isinf(body.velocity), self.velocity_limit, body.velocity)

    def joint_friction(self, body: Skeleton) -> tuple[Array, Array]:
        """(4, 3) viscous [N m s/rad] and dry [N m] friction of the joints."""
        return (
            np.where(np.isnan(body.damping), self.damping, body.damping),
            np.where(np.isnan(body.friction), self.friction, body.friction),
        )
