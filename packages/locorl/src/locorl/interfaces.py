"""What locorl needs from the outside: bodies. Any package that satisfies these Protocols will do."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class DesignSpace(Protocol):
    """Named, bounded design parameters; `d` of them."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the d parameters, in order."""
        ...

    @property
    def low(self) -> Array:
        """Lower bounds, (d,)."""
        ...

    @property
    def high(self) -> Array:
        """Upper bounds, (d,)."""
        ...

    @property
    def nominal(self) -> Array:
        """The body as it is, (d,)."""
        ...


class Layout(Protocol):
    """Names that let a controller find its way around the model of a quadruped.

    The 12 actuated joints stand in policy order (legs FL, FR, RL, RR, each hip, thigh, knee), which is
    also their order in `qpos[7:]`, `qvel[6:]` and `ctrl`.
    """

    @property
    def robot(self) -> str:
        """Name of the robot."""
        ...

    @property
    def base(self) -> str:
        """Name of the base body, which carries the free joint."""
        ...

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the 12 actuated joints in policy order."""
        ...

    @property
    def feet(self) -> tuple[str, ...]:
        """Names of the 4 sites at the centres of the feet."""
        ...

    @property
    def foot_contact(self) -> tuple[str, ...]:
        """Names of the 4 sensors of the feet: number of contacts, then the net force that the foot exerts, N.

        Each has size 4, or 1 without the force; world axes.
        """
        ...

    @property
    def link_contact(self) -> tuple[str, ...]:
        """Names of the sensors that count the contacts of a link other than a foot; the base is first."""
        ...


class BodyBatch(Protocol):
    """n bodies as one compiled model and the fields in which each of them differs from it."""

    @property
    def designs(self) -> Array:
        """Design parameters, (n, d)."""
        ...

    @property
    def model(self) -> mujoco.MjModel:
        """The nominal body in its scene."""
        ...

    @property
    def fields(self) -> Mapping[str, Array]:
        """MjModel field name -> (n, *field shape); to be written before `set_const`."""
        ...

    @property
    def stance_qpos(self) -> Array:
        """Standing on the plane z = 0 at the origin, (n, 19)."""
        ...

    @property
    def stance_ctrl(self) -> Array:
        """PD targets that hold the stance against gravity, (n, 12), rad."""
        ...

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Whether the body has a stance, (n,)."""
        ...

    @property
    def kp(self) -> Array:
        """Proportional gains, (n, 12), N m/rad."""
        ...

    @property
    def kd(self) -> Array:
        """Derivative gains, (n, 12), N m s/rad."""
        ...

    @property
    def torque_limit(self) -> Array:
        """Torque limits, (n, 12), N m."""
        ...

    @property
    def total_mass(self) -> Array:
        """Mass of the robot, (n,), kg."""
        ...


class BodyFactory(Protocol):
    """Makes bodies from design parameters."""

    @property
    def name(self) -> str:
        """Name of the robot."""
        ...

    @property
    def space(self) -> DesignSpace:
        """The design space."""
        ...

    @property
    def layout(self) -> Layout:
        """Names of joints, feet and sensors; the same for every body."""
        ...

    def batch(self, designs: Array, scene: mujoco.MjSpec | None = None) -> BodyBatch:
        """Bodies of `designs` (n, d) placed in a copy of `scene`."""
        ...


@runtime_checkable
class Ruled(Protocol):
    """A body factory that says what its bodies follow from besides their designs."""

    @property
    def rules(self) -> Mapping[str, str]:
        """Choices by name, such as `scaling` and `gains`: with others, the same design is another body."""
        ...
