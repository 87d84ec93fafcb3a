"""n bodies as per-simulation fields of one compiled MuJoCo model."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import ArrayLike, NDArray

from morphgen.skeleton import Array

DERIVED = (
    "body_subtreemass",
    "body_invweight0",
    "dof_invweight0",
    "dof_M0",
    "actuator_acc0",
    "geom_rbound",
    "geom_aabb",
)
"""Model fields that MuJoCo derives from the others."""


@dataclass(frozen=True)
class BodyBatch:
    """n bodies that share the structure of one model.

    Attributes:
        designs: (n, d) design vectors.
        model: the nominal body in its scene.
        fields: every MjModel field that differs between bodies, (n, *shape of the field); write them through
            `mujoco.batch.Batch.expand()`, then call `Batch.set_const()`, which derives the rest; for engines
            that cannot, see `derived`.
        stance_qpos: (n, nq) stance on a floor at z = 0: base at x = y = 0 and level.
        stance_ctrl: (n, 12) servo targets that hold the stance: its angles + static torque / kp [rad].
        feasible: (n,) whether the stance is sound, see `morphgen.Stance`, and does not buckle on the servos' springs.
        kp: (n, 12) servo stiffness [N m/rad].
        kd: (n, 12) servo damping [N m s/rad].
        torque_limit: (n, 12) [N m].
        velocity_limit: (n, 12) [rad/s]; data for controllers, not enforced by the model.
        joint_lower: (n, 12) [rad]; -2 pi for a joint without limits.
        joint_upper: (n, 12) [rad]; 2 pi for a joint without limits.
        total_mass: (n,) [kg].
        hip_height: (n,) height of the thigh joint axes above the floor in the stance [m].
    """

    designs: Array
    model: mujoco.MjModel
    fields: Mapping[str, Array]
    stance_qpos: Array
    stance_ctrl: Array
    feasible: NDArray[np.bool_]
    kp: Array
    kd: Array
    torque_limit: Array
    velocity_limit: Array
    joint_lower: Array
    joint_upper: Array
    total_mass: Array
    hip_height: Array

    @property
    def n(self) -> int:
        """Number of bodies."""
        return len(self.designs)

    def take(self, ids: ArrayLike) -> BodyBatch:
        """The bodies with these row numbers, (m,), in this order; repeats allowed."""
        rows = np.asarray(ids)
        if rows.ndim != 1 or not np.issubdtype(rows.dtype, np.integer):
            raise TypeError(f"ids must be a vector of integers, got shape {rows.shape} of {rows.dtype}")
        shared = ("model", "fields")
        arrays = {name: getattr(self, name)[rows] for name in self.__dataclass_fields__ if name not in shared}
        return replace(self, **arrays, fields={name: values[rows] for name, values in self.fields.items()})

    def derived(self, threads: int = 0) -> dict[str, Array]:
        """The fields that MuJoCo derives (inverse weights, bounding volumes ...), (n, *shape of the field).

        Args:
            threads: worker threads; 0 for one per core.
        """
        sims = mujoco.batch.Batch(self.model, self.n, threads)
        for name, values in self.fields.items():
            sims.expand(name)[:] = values
        views = {name: sims.expand(name) for name in DERIVED}
        sims.set_const()
        return {name: np.array(values) for name, values in views.items()}
