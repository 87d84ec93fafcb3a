"""Replay a log: feed the readings of a run to a bundle and compare what it answers, bit by bit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deploy.bundles.manifest import Bundle
from deploy.control.binding import JointBinding
from deploy.errors import LogError
from deploy.interfaces import PolicyRuntime
from deploy.policy.tick import Policy
from deploy.robots.replay_robot import LoggedTick, ReplayRobot


@dataclass(frozen=True)
class Difference:
    """The first number of a log that a bundle does not reproduce.

    Attributes:
        tick: Slot of the schedule.
        what: "action of", or "observation" where that differs already.
        element: Joint, or observation term with the place in it.
        logged: The number in the log.
        replayed: The number now.
    """

    tick: int
    what: str
    element: str
    logged: float
    replayed: float

    def __str__(self) -> str:
        return (
            f"tick {self.tick}: {self.what} {self.element} is {self.replayed:.9g}, the log says {self.logged:.9g} "
            f"(difference {self.replayed - self.logged:.3g})"
        )


@dataclass(frozen=True)
class ReplayResult:
    """What a replay found.

    Attributes:
        ticks: Ticks on which the policy ran.
        identical: Those whose actions are equal in every bit.
        largest: Largest absolute difference of an action.
        first: The first difference; None where every action is reproduced.
        terms: Largest absolute difference of each observation term.
    """

    ticks: int
    identical: int
    largest: float
    first: Difference | None
    terms: Mapping[str, float]


def replay(log: str | Path, bundle: Bundle, runtime: PolicyRuntime) -> ReplayResult:
    """Feed a log to a bundle.

    The recurrent states, the previous action and all that was seen go on from tick to tick as on the robot; images
    are used from the tick on that the log says, so that a run whose depth encoder was too late is reproduced too.

    Args:
        log: A complete .mcap file of this package.
        bundle: A verified bundle; the one of the run, or another one to compare with it.
        runtime: Its networks.

    Returns:
        How many ticks are reproduced, and where the first one is not.

    Raises:
        LogError: The file is missing, torn, altered, not a log of this package, or lacks ticks, or no policy ran in it.
        RobotError: The log is one of a robot with other joints.
    """
    robot = ReplayRobot(log, bundle)
    binding = JointBinding.of(bundle, robot.spec)
    policy = Policy(bundle, runtime)
    ran, identical, largest, first = 0, 0, 0.0, None
    terms = {term.name: 0.0 for term in bundle.terms}
    running = False
    try:
        for index in range(len(robot.ticks)):
            tick = robot.go_to(index)
            if tick.obs is None or tick.action is None:
                running = False
                continue
            if not running:
                policy.reset()
            elif lost := robot.lost_before(index):
                raise LogError(
                    f"{log}: {lost} ticks are missing before slot {tick.slot.index} (the disk was slow, or the log was "
                    "recovered); what the policy remembers of them cannot be replayed"
                )
            running, ran = True, ran + 1
            state = binding.state(robot.read())
            step = policy.step(state, tick.command, robot.read_depth, tick.slot.start_ns, tick.seen_tick)
            action = step.action.astype(np.float32)
            same = action.tobytes() == tick.action.tobytes()
            identical += same
            largest = max(largest, float(np.abs(action - tick.action).max()))
            if step.obs.shape == tick.obs.shape:
                _widen(terms, bundle, step.obs, tick.obs)
            if not same and first is None:
                first = _difference(bundle, tick, step.obs, action)
    finally:
        policy.close()
    if ran == 0:
        raise LogError(f"{log}: the policy never ran in it ({robot.ticks[-1].mode} at its end); nothing to replay")
    return ReplayResult(ran, identical, largest, first, terms)


def _widen(terms: dict[str, float], bundle: Bundle, obs: NDArray[np.float32], logged: NDArray[np.float32]) -> None:
    place = 0
    for term in bundle.terms:
        part = slice(place, place + term.size)
        terms[term.name] = max(terms[term.name], float(np.abs(obs[part] - logged[part]).max()))
        place += term.size


def _difference(bundle: Bundle, tick: LoggedTick, obs: NDArray[np.float32], action: NDArray[np.float32]) -> Difference:
    """Where the difference began: in the observation, if that is another one."""
    assert tick.obs is not None
    assert tick.action is not None
    if obs.shape == tick.obs.shape and (obs != tick.obs).any():
        names = [f"{term.name}[{place}]" for term in bundle.terms for place in range(term.size)]
        return _first(tick.slot.index, "observation", names, tick.obs, obs)
    return _first(tick.slot.index, "action of", list(bundle.joint_names), tick.action, action)


def _first(
    tick: int, what: str, names: list[str], logged: NDArray[np.float32], found: NDArray[np.float32]
) -> Difference:
    place = int(np.argmax(logged.view(np.uint32) != found.view(np.uint32)))
    return Difference(tick, what, names[place], float(logged[place]), float(found[place]))
