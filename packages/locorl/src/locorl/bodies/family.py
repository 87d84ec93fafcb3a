"""The family of bodies that a policy was trained on: the rules that make them, and the servos that drive them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from locorl.interfaces import BodyFactory, Ruled


@dataclass(frozen=True)
class BodyFamily:
    """What bodies follow from besides their designs.

    Attributes:
        rules: choices by name, such as `scaling` and `gains`; empty where the factory tells none.
        kp: proportional gains of the nominal body, 12, N m/rad.
        kd: its derivative gains, 12, N m s/rad.
    """

    rules: Mapping[str, str]
    kp: tuple[float, ...]
    kd: tuple[float, ...]

    @classmethod
    def of(cls, factory: BodyFactory) -> BodyFamily:
        """The family of a factory's bodies; compiles the nominal one."""
        nominal = factory.batch(np.asarray(factory.space.nominal, dtype=np.float64)[None])
        rules = dict(factory.rules) if isinstance(factory, Ruled) else {}
        return cls(rules, tuple(map(float, nominal.kp[0])), tuple(map(float, nominal.kd[0])))

    @property
    def signature(self) -> dict[str, str]:
        """In words to compare: name -> value; of gains six digits, for machines may differ in the last ones."""
        return {**self.rules, "kp": _short(self.kp), "kd": _short(self.kd)}

    def differences(self, here: BodyFamily) -> list[str]:
        """Where the family `here` differs from this one of a training, as far as both tell."""
        other = here.signature
        return [
            f"{name}: {value} in its training, {other[name]} here"
            for name, value in self.signature.items()
            if other.get(name, value) != value
        ]


def _short(gains: tuple[float, ...]) -> str:
    words = [f"{gain:.6g}" for gain in gains]
    return words[0] if len(set(words)) == 1 else f"({', '.join(words)})"
