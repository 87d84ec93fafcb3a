"""Named, bounded design parameters of a family of bodies, and what they do to the parts of a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from morphgen.errors import MorphologyError

Array = NDArray[np.float64]

SCALE_NAMES = ("front_thigh", "front_shank", "hind_thigh", "hind_shank")
"""Order of the four leg scales, as xi_0 ... xi_3 in the note of Table II."""

PARAMETERS: Mapping[str, str] = MappingProxyType(
    {
        "front_thigh": "length scale of both front thighs",
        "front_shank": "length scale of both front shanks",
        "hind_thigh": "length scale of both hind thighs",
        "hind_shank": "length scale of both hind shanks",
        **{
            f"{leg}_{part}": f"length scale of the {place} {part}, times that of its pair"
            for leg, place in (("fl", "front left"), ("fr", "front right"), ("rl", "rear left"), ("rr", "rear right"))
            for part in ("thigh", "shank")
        },
        "hip_offset": "scale of the lateral distance from hip joint to thigh joint; the mass stays",
        "trunk_length": "scale of the trunk along x, with the hips; the mass stays",
        "trunk_mass": "factor on mass and inertia of the trunk",
        "hip_mass": "factor on mass and inertia of the hips",
        "thigh_mass": "factor on mass and inertia of the thighs, at equal length",
        "shank_mass": "factor on mass and inertia of the shanks, at equal length, without the feet",
        "motor_placement": "place of the knee motor along the thigh: 0 as built, 1 a thigh's length further down "
        "(rule 'lumped')",
        "foot_radius": "scale of the foot ball; its mass follows the cube",
    }
)
"""Every parameter that a `DesignSpace` can have, and its meaning. Scales have nominal 1, the placement 0."""

BOUNDS: Mapping[str, tuple[float, float]] = MappingProxyType(
    dict.fromkeys(PARAMETERS, (0.6, 1.4))
    | dict.fromkeys(("trunk_mass", "hip_mass", "thigh_mass", "shank_mass"), (0.7, 1.5))
    | {"hip_offset": (0.7, 1.5), "trunk_length": (0.8, 1.3), "motor_placement": (0.0, 1.0), "foot_radius": (0.7, 1.5)}
)
"""Usual lower and upper bounds of every parameter: the paper's for lengths, moderate ones of ours for the rest."""

_LEGS = ("fl", "fr", "rl", "rr")
_PARTS = ("hip", "thigh", "shank")


@dataclass(frozen=True)
class Morphology:
    """What n designs ask of the parts of a robot; legs in the order FL, FR, RL, RR.

    Attributes:
        length: (n, 4, 3) scales of hip (sideways), thigh and shank.
        trunk_length: (n,) scale along x.
        mass: (n, 4, 3) factors on hip, thigh and shank, besides what length does to mass.
        trunk_mass: (n,) factor.
        motor: (n,) shift of the knee motor along the thigh, in thigh lengths.
        foot: (n,) scale of the foot's radius.
    """

    length: Array
    trunk_length: Array
    mass: Array
    trunk_mass: Array
    motor: Array
    foot: Array

    @property
    def n(self) -> int:
        """Number of designs."""
        return len(self.length)


@dataclass(frozen=True)
class DesignSpace:
    """A box of design parameters.

    Attributes:
        names: the d parameters, in the order of every design vector; see `PARAMETERS`.
        low: (d,) lower bounds, included.
        high: (d,) upper bounds, included.
        nominal: (d,) the unmodified robot.

    Example:
        >>> DesignSpace.of(front_thigh=(0.8, 1.2), hind_thigh=(0.8, 1.2), trunk_length=(0.9, 1.3))
    """

    names: tuple[str, ...]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    nominal: NDArray[np.float64]

    def __post_init__(self) -> None:
        if not self.names or len(set(self.names)) != len(self.names):
            raise MorphologyError(f"design space: needs different names, got {self.names}")
        for name in self.names:
            if name not in PARAMETERS:
                raise MorphologyError(f"design space: unknown parameter '{name}'; known: {', '.join(PARAMETERS)}")
        for field in ("low", "high", "nominal"):
            values = np.array(getattr(self, field), dtype=np.float64)
            if values.shape != (len(self.names),):
                raise MorphologyError(f"design space: {field} needs {len(self.names)} values, got {values.shape}")
            values.flags.writeable = False
            object.__setattr__(self, field, values)
        if not (np.all(self.low <= self.nominal) and np.all(self.nominal <= self.high)):
            raise MorphologyError("design space: needs low <= nominal <= high for every parameter")
        if not np.all(np.isfinite([self.low, self.high])):
            raise MorphologyError("design space: bounds must be finite")
        for name, low in zip(self.names, self.low, strict=True):
            if name != "motor_placement" and low <= 0:
                raise MorphologyError(f"design space: the scale '{name}' must be positive, its lower bound is {low:g}")

    @classmethod
    def leg_scales(cls, low: float = 0.6, high: float = 1.4) -> DesignSpace:
        """The paper's four leg scales (Section III-B), all in [low, high], nominal 1."""
        d = len(SCALE_NAMES)
        return cls(SCALE_NAMES, np.full(d, low), np.full(d, high), np.ones(d))

    @classmethod
    def of(cls, **bounds: tuple[float, float]) -> DesignSpace:
        """A space of these parameters with these bounds; the nominal is the unmodified robot."""
        low, high = np.array(list(bounds.values()), dtype=np.float64).reshape(-1, 2).T
        nominal = [0.0 if name == "motor_placement" else 1.0 for name in bounds]
        return cls(tuple(bounds), low, high, np.array(nominal))

    @classmethod
    def per_leg(cls, low: float = 0.6, high: float = 1.4) -> DesignSpace:
        """Thigh and shank of each leg by itself, eight scales."""
        return cls.of(**{f"{leg}_{part}": (low, high) for leg in _LEGS for part in _PARTS[1:]})

    @classmethod
    def wide(cls) -> DesignSpace:
        """The paper's four scales and hip offset, trunk length, masses and foot radius."""
        more = ("hip_offset", "trunk_length", "trunk_mass", "thigh_mass", "shank_mass", "foot_radius")
        return cls.of(**{name: BOUNDS[name] for name in (*SCALE_NAMES, *more)})

    @property
    def dim(self) -> int:
        """Number of parameters d."""
        return len(self.names)

    def contains(self, designs: ArrayLike) -> NDArray[np.bool_]:
        """Whether each design lies in the box: (n, d) -> (n,). NaN lies outside."""
        x = np.atleast_2d(np.asarray(designs, dtype=np.float64))
        return np.all((x >= self.low) & (x <= self.high), axis=-1)

    def validated(self, designs: ArrayLike) -> NDArray[np.float64]:
        """A float64 copy of the designs, (n, d); a single design (d,) becomes (1, d).

        Raises:
            MorphologyError: wrong shape, or a value that is not finite or out of bounds; names the
                design's row and the parameter.
        """
        try:
            x = np.atleast_2d(np.array(designs, dtype=np.float64))
        except (TypeError, ValueError) as error:
            raise MorphologyError(f"designs must be numbers of shape (n, {self.dim}): {error}") from error
        if x.ndim != 2 or x.shape[1] != self.dim:
            raise MorphologyError(
                f"designs need shape (n, {self.dim}) in the order {', '.join(self.names)}; got {x.shape}"
            )
        outside = ~((x >= self.low) & (x <= self.high))
        if outside.any():
            row, column = np.argwhere(outside)[0]
            raise MorphologyError(
                f"design {row}: {self.names[column]} = {x[row, column]:g} is outside "
                f"[{self.low[column]:g}, {self.high[column]:g}]"
            )
        return x

    def sample(self, n: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """N uniform designs, (n, d)."""
        return rng.uniform(self.low, self.high, (n, self.dim))

    def morphology(self, designs: Array) -> Morphology:
        """What validated designs (n, d) ask of the parts."""
        n = len(designs)
        value = {name: designs[:, i] for i, name in enumerate(self.names)}
        one = np.ones(n)

        def get(name: str) -> Array:
            return value.get(name, one)

        length, mass = np.ones((n, 4, 3)), np.ones((n, 4, 3))
        length[:, :, 0] = get("hip_offset")[:, None]
        for i, leg in enumerate(_LEGS):
            pair = "front" if leg[0] == "f" else "hind"
            for k, part in ((1, "thigh"), (2, "shank")):
                length[:, i, k] = get(f"{pair}_{part}") * get(f"{leg}_{part}")
        for k, part in enumerate(_PARTS):
            mass[:, :, k] = get(f"{part}_mass")[:, None]
        return Morphology(
            length=length,
            trunk_length=get("trunk_length"),
            mass=mass,
            trunk_mass=get("trunk_mass"),
            motor=value.get("motor_placement", np.zeros(n)),
            foot=get("foot_radius"),
        )
