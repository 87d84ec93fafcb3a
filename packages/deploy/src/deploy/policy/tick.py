"""A policy tick: observation, networks, action rule. The golden trace, the controller and replay share it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deploy.bundles.manifest import Bundle
from deploy.interfaces import Array, PolicyRuntime, RobotState, Seen
from deploy.policy.observation import ObservationBuilder
from deploy.policy.perception import Camera, Perception, Picture


@dataclass(frozen=True)
class PolicyStep:
    """What one tick computed.

    Attributes:
        obs: What went into the network, shape (P,).
        action: What came out, shape (12,).
        target: Joint targets, policy order, shape (12,), rad.
        velocity: Estimated base velocity, base frame, shape (3,), m/s, or None.
        seen: What a seeing policy had in use; None for a blind one.
        picture: The image that entered the depth encoder at this tick, if one did.
    """

    obs: NDArray[np.float32]
    action: Array
    target: Array
    velocity: Array | None
    seen: Seen | None = None
    picture: Picture | None = None


class Policy:
    """Turns robot states and images into joint targets; keeps the previous (clipped) action and what was seen."""

    def __init__(self, bundle: Bundle, runtime: PolicyRuntime, wait: bool = True) -> None:
        """Start from a reset.

        Args:
            bundle: A verified bundle.
            runtime: Its networks.
            wait: Whether a tick waits for the depth encoder, see `Perception`.
        """
        self._runtime = runtime
        self._builder = ObservationBuilder(bundle)
        self._offset = bundle.per_joint("target_offset")
        self._scale = bundle.action.scale
        self._clip = np.inf if bundle.action.clip is None else bundle.action.clip
        self.perception = (
            None if bundle.depth is None else Perception(runtime, bundle.depth, bundle.period_ns, wait=wait)
        )
        """Of a policy that sees; None for a blind one."""
        self.reset()

    def reset(self) -> None:
        """Forget the previous action, the recurrent states and what was seen."""
        if self.perception is None:
            self._runtime.reset()
        else:
            self.perception.reset()
        self._last_action = np.zeros_like(self._offset)

    def close(self) -> None:
        """End the worker of a policy that sees."""
        if self.perception is not None:
            self.perception.close()

    def step(
        self,
        state: RobotState,
        command: Array,
        camera: Camera = lambda: None,
        now_ns: int = 0,
        seen_tick: int | None = None,
    ) -> PolicyStep:
        """One tick.

        Args:
            state: Joints and feet in policy order.
            command: (vx, vy, yaw_rate), base frame, m/s and rad/s.
            camera: Gives the latest depth frame; a blind policy does not ask.
            now_ns: Time of this tick on the clock of the frames, ns.
            seen_tick: Tick whose image is to be in use, as a log says; None: by the bundle's latency.
        """
        obs = self._builder.build(state, command, self._last_action)
        seen = picture = None
        if self.perception is not None:
            seen, picture = self.perception.step(obs, camera, now_ns, seen_tick)
        output = self._runtime.step(obs, seen)
        self._last_action = np.clip(output.action, -self._clip, self._clip)
        target = self._offset + self._scale * self._last_action
        return PolicyStep(obs, output.action, target, output.velocity, seen, picture)
