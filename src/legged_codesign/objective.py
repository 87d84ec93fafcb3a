"""What a body is scored by: return, energy or cost of transport, with tracking as a constraint."""

from __future__ import annotations

import numpy as np
from locorl import EvalConfig, Evaluation
from locorl.interfaces import Array

from legged_codesign.config import Objective, ScoreConfig

CAP = 2.0
"""Cost of transport of a robot that fell or did not get anywhere; a walking Go2 has about 0.3."""

PENALTY = 3.0
"""Cost of transport that each m/s of tracking error beyond the limit adds; 0.1 m/s doubles that of a walker."""

UNITS = {"return": "return", "energy": "J", "cost-of-transport": "cost of transport"}


def evaluation_config(score: ScoreConfig, seed: int) -> EvalConfig:
    """The protocol under which bodies are scored; equal seeds give equal starts on every body."""
    return EvalConfig(
        seconds=score.seconds,
        vx=score.vx,
        settle=min(2.0, score.seconds / 3),
        robots_per_body=score.robots,
        reset_joint=0.1,
        seed=seed,
    )


def robot_scores(result: Evaluation, objective: Objective, score: ScoreConfig) -> Array:
    """Score of each robot, (B, R); higher is better.

    `return` is eq. 9. The two costs are negated. Cost of transport is positive joint work over weight and
    way; energy is positive joint work in joules over the episode (eq. 10 times the time step). PENALTY times
    the tracking error beyond the limit is added to either, and a robot that fell, did not come through its course,
    or is worse than CAP, counts CAP: standing still or falling early does not pay.
    """
    if objective == "return":
        return result.returns
    # joules become a cost of transport at the commanded way, so that one cap serves both
    way = result.commanded_distance
    cost = result.cost_of_transport if objective == "cost-of-transport" else result.energy / (result.weight * way)
    excess = np.maximum(result.tracking_error - score.max_error, 0.0)
    cost = np.minimum(np.where(result.through, cost + PENALTY * excess, CAP), CAP)
    return -cost if objective == "cost-of-transport" else -cost * result.weight * way


def physical(score: float, objective: Objective) -> float:
    """A score as the quantity that it stands for: costs are positive, returns stay."""
    return score if objective == "return" else -score
