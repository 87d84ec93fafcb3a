"""What a step of the environment tells besides observation, reward and ends."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class StepInfo(NamedTuple):
    """Further results of one control step.

    Attributes:
        done_ids: robots whose episode ended in this step, ascending, (m,).
        final_obs: their last observation of that episode, group -> (m, dim); the bootstrap of those that were cut
            by time needs it.
        reward_terms: mean over robots of each weighted reward term, name -> ().
        speed: along the commanded way, (N,), m/s: forward, or towards the next waypoint.
        tracking_error: |speed - commanded speed|, (N,), m/s.
        positive_work: positive joint work in this step, (N,), J.
        diverged: robots whose simulation failed in this step, (N,) bool.
        velocity: base velocity after the step, before any reset, base frame, (N, 3), m/s.
        position: base position likewise, world frame, (N, 3), m.
        success: robots that reached their last waypoint in this step, (N,) bool.
        level: of the terrain that each robot stood on, (N,).
    """

    done_ids: Tensor
    final_obs: dict[str, Tensor]
    reward_terms: dict[str, Tensor]
    speed: Tensor
    tracking_error: Tensor
    positive_work: Tensor
    diverged: Tensor
    velocity: Tensor
    position: Tensor
    success: Tensor
    level: Tensor
