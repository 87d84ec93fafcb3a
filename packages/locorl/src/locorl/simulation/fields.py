"""Per-simulation model fields: how N different bodies share one compiled model."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch

from locorl.interfaces import Array


def batch_of(model: mujoco.MjModel, count: int, threads: int, fields: Mapping[str, Array]) -> Batch:
    """`count` simulations of `model` that differ in `fields`, (count, *field shape) each."""
    batch = Batch(model, count, threads)
    write_fields(batch, fields)
    return batch


def write_fields(batch: Batch, fields: Mapping[str, Array]) -> None:
    """Write per-simulation fields and let the constants derived from them follow.

    `set_const` derives inertia weights, subtree masses, bounding volumes and merged frames, so that each
    simulation equals a model compiled for its body.

    Raises:
        ValueError: no such field, it cannot differ between simulations, or its shape does not fit; nothing
            is written then.
    """
    for name, values in fields.items():
        if name not in MODEL_FIELDS:
            raise ValueError(f"'{name}' is no model field that can differ between simulations")
        owner, _, attribute = name.rpartition(".")
        field = getattr(batch.model.opt if owner else batch.model, attribute)
        shape = (batch.nsim, *np.shape(field))
        if np.shape(values) != shape:
            raise ValueError(f"field '{name}' must have shape {shape}, got {np.shape(values)}")
    for name, values in fields.items():
        batch.expand(name)[...] = values
    batch.set_const()


def centre_of_mass(batch: Batch, qpos: Array) -> Array:
    """Centre of mass of each robot in pose `qpos`, relative to its base, (N, 3), m, world axes.

    Overwrites the state of `batch`.
    """
    subtree, position = batch.bind("subtree_com"), batch.bind("xpos")
    batch.bind("qpos")[...] = qpos
    batch.forward(stage=mujoco.mjtStage.mjSTAGE_POS.value)
    base = int(batch.model.jnt_bodyid[0])
    return subtree[:, base] - position[:, base]
