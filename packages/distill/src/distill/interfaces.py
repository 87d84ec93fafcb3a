"""What distill needs from others: an environment to visit states in, and a teacher to label them.

Any object of this shape will do; nothing is imported from the package that provides it.
N is the number of parallel robots.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from distill.errors import InterfaceError

Observation: TypeAlias = Mapping[str, Tensor]
"""Group name -> (N, dim) float32."""

ACTIONS = 12
VELOCITY = 3


class StudentEnv(Protocol):
    """A batch of N robots that restart by themselves.

    Observation groups (`group_dims` gives the width of each):
        proprio: (N, P) what the onboard sensors give, as listed in the bundle's observation terms.
        explicit: (N, 3) base linear velocity, base frame, m/s; simulator truth.
        implicit: (N, I) mass, design, friction and so on; simulator truth, read by the teacher only.
        Other groups may be present and are handed to the teacher.
    """

    @property
    def num_envs(self) -> int:
        """N."""
        ...

    @property
    def device(self) -> torch.device:
        """Where observations live and actions are expected."""
        ...

    @property
    def group_dims(self) -> Mapping[str, int]:
        """Width of each observation group."""
        ...

    def reset(self, seed: int | None = None) -> Observation:
        """Restart all robots; the same seed gives the same episodes under the same actions."""
        ...

    def step(self, action: Tensor) -> tuple[Observation, Tensor, Tensor, Tensor, object]:
        """Advance one control step.

        Args:
            action: (N, 12) network output, before clipping and scaling.

        Returns:
            observation: groups as above; of the new episode where a robot has just ended one.
            reward: (N,).
            terminated: (N,) bool, the robot failed.
            truncated: (N,) bool, the episode ran out of time.
            info: anything else; evaluation reads what it finds of `Measured`.
        """
        ...


class Teacher(Protocol):
    """A privileged policy."""

    def act(self, obs: Observation) -> Tensor:
        """Mean action (N, 12); deterministic, without gradient."""
        ...


@runtime_checkable
class PrivilegedTeacher(Protocol):
    """A teacher that opens its network, so that the student can start from a copy of it."""

    @property
    def latent_dim(self) -> int:
        """L, width of the privileged latent."""
        ...

    @property
    def actor(self) -> nn.Module:
        """Maps the concatenation [proprio, explicit, latent] (N, P + 3 + L) to the mean action (N, 12)."""
        ...

    def act(self, obs: Observation) -> Tensor:
        """Mean action (N, 12); deterministic, without gradient."""
        ...

    def latent(self, obs: Observation) -> Tensor:
        """Output (N, L) of the privileged encoder, without gradient."""
        ...


@runtime_checkable
class ScanTeacher(PrivilegedTeacher, Protocol):
    """A teacher that sees the terrain: its actor maps [proprio, scan latent, explicit, latent] to the mean action."""

    @property
    def scan_latent_dim(self) -> int:
        """S, width of the scan latent; 0 for a policy without one."""
        ...

    def scan_latent(self, obs: Observation) -> Tensor:
        """Latent (N, S) of the terrain around the robot, within +-1, without gradient."""
        ...


class VisionEnv(StudentEnv, Protocol):
    """Robots with a depth camera and a way to go.

    The group "proprio" holds the oracle headings: directions to the next waypoints as seen from the robot, rad, which
    no sensor gives. They may be refreshed as rarely as the camera takes images.
    """

    @property
    def heading(self) -> slice:
        """Columns of the oracle headings in "proprio"."""
        ...

    @property
    def depth_shape(self) -> tuple[int, int]:
        """Rows and columns of an image."""
        ...

    @property
    def depth_period(self) -> int:
        """Control steps between two images; the first one is taken at the reset."""
        ...

    @property
    def depth(self) -> Tensor:
        """The images (N, rows, columns) taken last, from -0.5 (near) to 0.5 (far, or nothing), without any latency.

        At every `depth_period`th step they are of that very instant.
        """
        ...


class Measured(Protocol):
    """What an environment may tell of a step in its `info`, for evaluation; either may be missing, or None."""

    @property
    def tracking_error(self) -> Tensor | None:
        """|commanded speed - speed| of each robot, (N,), m/s."""
        ...

    @property
    def success(self) -> Tensor | None:
        """Robots that did all they had to in this step, (N,) bool."""
        ...


@runtime_checkable
class GroupedEnv(Protocol):
    """An environment whose robots differ in ways that a table should tell apart."""

    def groups(self) -> Mapping[str, Sequence[str]]:
        """What robots differ in -> each robot's group, (N,), in the episodes that `reset` has just begun.

        For example "terrain" -> ("hills", "steps", ...), "body" -> ("short legs", ...).
        """
        ...


@runtime_checkable
class FilmedEnv(Protocol):
    """An environment that draws pictures."""

    @property
    def control_dt(self) -> float:
        """Time between two control steps, s."""
        ...

    def picture(self, robot: int, width: int, height: int) -> NDArray[np.uint8]:
        """One robot as it is now, (height, width, 3), red, green, blue."""
        ...


@runtime_checkable
class Signed(Protocol):
    """An environment or teacher that says what the two must have in common."""

    @property
    def signature(self) -> Mapping[str, object]:
        """What -> value, such as robot, observation terms, control period and scale of actions."""
        ...


def check_teacher(env: StudentEnv, teacher: Teacher) -> None:
    """Check that a teacher is one for the robots of an environment, as far as both tell.

    Raises:
        InterfaceError: naming what differs.
    """
    if not isinstance(env, Signed) or not isinstance(teacher, Signed):
        return
    here, there = env.signature, teacher.signature
    if unequal := [what for what, value in here.items() if what in there and there[what] != value]:
        raise InterfaceError(
            "this teacher was trained on other robots than those of the environment; choose the environment's options "
            "as in its training. "
            + "; ".join(f"{what}: {there[what]} in its training, {here[what]} here" for what in unequal)
        )


def check_env(env: StudentEnv) -> None:
    """Check the observation groups of an environment.

    Raises:
        InterfaceError: a group is missing or has the wrong width.
    """
    dims = env.group_dims
    for group in ("proprio", "explicit"):
        if group not in dims:
            raise InterfaceError(f"the environment has no observation group '{group}'; it has {sorted(dims)}")
    if dims["explicit"] != VELOCITY:
        raise InterfaceError(
            f"observation group 'explicit' is {dims['explicit']} wide; "
            f"expected {VELOCITY}: base linear velocity in the base frame, m/s"
        )
