"""Kernels of WarpSimulator; each thread serves one world."""

# ruff: noqa: ANN201, UP018
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false, reportAttributeAccessIssue=false
# pyright: reportOperatorIssue=false
# Warp's kernels are a language of their own
from __future__ import annotations

import warp as wp


@wp.kernel
def add_work(rate: wp.array2d[float], torque: wp.array2d[float], timestep: float, work: wp.array[float]):
    """Add each world's positive joint power (N m rad/s), summed over joints, times the time step."""
    world = wp.tid()
    power = float(0.0)
    for joint in range(torque.shape[1]):
        power += wp.max(torque[world, joint] * rate[world, 6 + joint], 0.0)
    work[world] = work[world] + power * timestep


@wp.kernel
def count_overflows(overflow: wp.array[int], masks: wp.array[int], counts: wp.array2d[int]):
    """Add 1 where a world's overflow bits meet the mask of a kind."""
    world, kind = wp.tid()  # pyright: ignore
    if (overflow[world] & masks[kind]) != 0:
        counts[world, kind] = counts[world, kind] + 1


@wp.kernel
def contain_divergence(
    qpos0: wp.array2d[float],
    limit: float,
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    warmstart: wp.array2d[float],
    torque: wp.array2d[float],
    sensors: wp.array2d[float],
    sites: wp.array2d[wp.vec3],
    work: wp.array[float],
    failed: wp.array[bool],
    diverged: wp.array[bool],
):
    """Flag worlds whose state is NaN or beyond `limit`, and put them back to a finite one."""
    world = wp.tid()
    fine = bool(True)
    for i in range(qpos.shape[1]):
        fine = fine and wp.abs(qpos[world, i]) < limit  # false for NaN
    for i in range(qvel.shape[1]):
        fine = fine and wp.abs(qvel[world, i]) < limit
        fine = fine and wp.abs(warmstart[world, i]) < limit  # the last acceleration
    if not fine:
        failed[world] = True
        for i in range(qpos.shape[1]):
            qpos[world, i] = qpos0[world % qpos0.shape[0], i]
        for i in range(qvel.shape[1]):
            qvel[world, i] = 0.0
            warmstart[world, i] = 0.0
        for i in range(torque.shape[1]):
            torque[world, i] = 0.0
        for i in range(sensors.shape[1]):
            sensors[world, i] = 0.0
        for i in range(sites.shape[1]):
            sites[world, i] = wp.vec3(0.0)
    if failed[world]:
        work[world] = 0.0
    diverged[world] = failed[world]
