"""Positive work of the joints, summed state by state."""

from __future__ import annotations

import numpy as np

from deploy.interfaces import Array, EnergyReading


class EnergyMeter:
    """Sums eq. 10's power over the states that a robot or simulator gives, each held for its own time."""

    def __init__(self, joints: int) -> None:
        self._energy = np.zeros(joints)
        self._peak = 0.0
        self._states = 0

    def add(self, dq: Array, tau: Array, seconds: float) -> None:
        """Count one state: velocities (n,), rad/s, and torques (n,), N m, of one instant that stands for `seconds`."""
        power = np.maximum(tau * dq, 0.0)
        self._energy += power * seconds
        self._peak = max(self._peak, float(power.sum()))
        self._states += 1

    def read(self) -> EnergyReading:
        """What was counted so far; restarts the peak."""
        reading = EnergyReading(self._energy.copy(), self._peak, self._states)
        self._peak = 0.0
        return reading
