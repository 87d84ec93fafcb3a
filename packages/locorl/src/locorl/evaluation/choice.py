"""Choosing between states of one policy by evaluations on common random numbers, and noticing a plateau.

The largest of several noisy means is too large on average: the evaluations that choose must not be the ones that
are reported. Report with another seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from locorl.evaluation.statistics import estimate
from locorl.interfaces import Array
from locorl.learning.policy import Policy


@dataclass(frozen=True)
class Candidate:
    """A policy as it was in the middle of a training, and how n robots did under it.

    Attributes:
        iteration: of the training; 0 is the policy that it started from.
        policy: a copy.
        returns: undiscounted return of each robot (eq. 9), (n,).
        energy: positive joint work of each robot (eq. 10 times the time step), (n,), J.
        survived: share of the robots that did not fall.
    """

    iteration: int
    policy: Policy
    returns: Array
    energy: Array
    survived: float


def best(candidates: Sequence[Candidate]) -> Candidate:
    """The one with the highest mean return; of equals, the earliest.

    Raises:
        ValueError: there are none.
    """
    return max(candidates, key=lambda candidate: float(candidate.returns.mean()))


def stalled(candidates: Sequence[Candidate], patience: int) -> bool:
    """Whether the last `patience` candidates in a row were no improvement.

    A candidate is one if its mean return exceeds that of the last improvement (at first: of the first candidate) by
    more than a standard error of the difference, robot by robot: they share their random numbers. Slow progress
    adds up to an improvement in the end; one policy in six that is no better passes for one by chance.
    """
    if not candidates:
        return False
    reference, since = candidates[0], 0
    for candidate in candidates[1:]:
        gain = estimate(candidate.returns - reference.returns)
        if gain.mean > (gain.sem if gain.n > 1 else 0.0):
            reference, since = candidate, 0
        else:
            since += 1
    return since >= patience
