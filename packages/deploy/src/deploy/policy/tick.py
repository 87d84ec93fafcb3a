"""A policy tick: observation, network, action rule. The golden trace and the controller share it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deploy.bundles.manifest import Bundle
from deploy.interfaces import Array, PolicyRuntime, RobotState
from deploy.policy.observation import ObservationBuilder


@dataclass(frozen=True)
class PolicyStep:
    """What one tick computed.

    Attributes:
        obs: What went into the network, shape (P,).
        action: What came out, shape (12,).
        target: Joint targets, policy order, shape (12,), rad.
        velocity: Estimated base velocity, base frame, shape (3,), m/s, or None.
    """

    obs: NDArray[np.float32]
    action: Array
    target: Array
    velocity: Array | None


class Policy:
    """Turns robot states into joint targets; keeps the previous (clipped) action and the recurrent state."""

    def __init__(self, bundle: Bundle, runtime: PolicyRuntime) -> None:
        self._runtime = runtime
        self._builder = ObservationBuilder(bundle)
        self._offset = bundle.per_joint("target_offset")
        self._scale = bundle.action.scale
        self._clip = np.inf if bundle.action.clip is None else bundle.action.clip
        self.reset()

    def reset(self) -> None:
        """Forget the previous action and the recurrent state."""
        self._runtime.reset()
        self._last_action = np.zeros_like(self._offset)

    def step(self, state: RobotState, command: Array) -> PolicyStep:
        """One tick; `state` has its joints in policy order, `command` is (vx, vy, yaw_rate)."""
        obs = self._builder.build(state, command, self._last_action)
        output = self._runtime.step(obs)
        self._last_action = np.clip(output.action, -self._clip, self._clip)
        target = self._offset + self._scale * self._last_action
        return PolicyStep(obs, output.action, target, output.velocity)
