"""Kinds of parameters: the values each may take, and how they fill one edge of the unit cube.

Every kind has a `name`, a `nominal` value, `fixed`, and bounds `low` and `high` of its column in design
arrays, where an integer stands as its value and a categorical as the index of its choice. Integers and
categoricals split [0, 1] into equal bins, so that every point of the unit cube is a valid design.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codesign_bo.space.values import Array, Value, plain, real, whole

_LARGEST_INTEGER = 2**48  # up to here the middles of bins are exact enough to be told apart


@dataclass(frozen=True)
class Continuous:
    """A real number.

    Attributes:
        name: Its name, unique in the space.
        low: Lower bound, in the parameter's own unit.
        high: Upper bound.
        nominal: Value in the nominal design, within the bounds.
        fixed: Whether every design keeps the nominal value.
        log: Whether the search sees its logarithm; for positive values over several magnitudes.

    Raises:
        ValueError: The bounds are no increasing finite numbers, not positive although `log`, or the nominal
            value lies outside.
    """

    name: str
    low: float
    high: float
    nominal: float
    fixed: bool = False
    log: bool = False

    def __post_init__(self) -> None:
        for key in ("low", "high", "nominal"):
            value = real(getattr(self, key))
            if value is None:
                raise ValueError(f"parameter {self.name}: {key} is {getattr(self, key)!r}; it must be a number")
            object.__setattr__(self, key, value)
        if not all(map(math.isfinite, (self.low, self.high, self.nominal, self.high - self.low))):
            raise ValueError(f"parameter {self.name}: bounds and nominal value must be finite, got {self}")
        _check_order(self)
        if self.log and self.low <= 0:
            raise ValueError(f"parameter {self.name}: a log scale needs a lower bound above 0, got {self.low}")

    def check(self, value: object) -> float:
        """Return `value` as a float.

        Raises:
            ValueError: It is no number within the bounds.
        """
        number = real(value)
        if number is None or not self.low <= number <= self.high:
            raise ValueError(f"{self.name} = {value!r}, but it must be a number in [{self.low}, {self.high}]")
        return number

    def encode(self, value: object) -> float:
        """Return `value` as it stands in a design array."""
        number = real(value)
        if number is None:
            raise ValueError(f"{self.name} = {value!r}, but it must be a number")
        return number

    def decode(self, number: float) -> float:
        """Return the value that stands in a design array."""
        return float(number)

    def to_unit(self, column: Array) -> Array:
        """Map a column (n,) of designs to the unit interval."""
        if self.log:
            return np.log(column / self.low) / math.log(self.high / self.low)
        return (column - self.low) / (self.high - self.low)

    def from_unit(self, column: Array) -> Array:
        """Map coordinates (n,) of the unit interval to a column of designs."""
        if self.log:
            natural = self.low * np.exp(column * math.log(self.high / self.low))
        else:
            natural = self.low + column * (self.high - self.low)
        return np.clip(natural, self.low, self.high)

    def snap(self, column: Array) -> Array:
        """Return the coordinates (n,) unchanged."""
        return column

    def features(self, column: Array) -> Array:
        """Return what a Gaussian process should see of coordinates (n,): themselves, as (n, 1)."""
        return column[:, None]

    @property
    def feature_dim(self) -> int:
        """Number of features."""
        return 1


@dataclass(frozen=True)
class Integer:
    """A whole number.

    Attributes:
        name: Its name, unique in the space.
        low: Smallest value.
        high: Largest value.
        nominal: Value in the nominal design, within the bounds.
        fixed: Whether every design keeps the nominal value.

    Raises:
        ValueError: The bounds are no increasing integers, or the nominal value lies outside.
    """

    name: str
    low: int
    high: int
    nominal: int
    fixed: bool = False

    def __post_init__(self) -> None:
        for key in ("low", "high", "nominal"):
            value = whole(getattr(self, key))
            if value is None or abs(value) > _LARGEST_INTEGER:
                raise ValueError(
                    f"parameter {self.name}: {key} is {getattr(self, key)!r}; it must be an integer of at most 2**48"
                )
            object.__setattr__(self, key, value)
        _check_order(self)

    @property
    def count(self) -> int:
        """Number of values."""
        return self.high - self.low + 1

    def check(self, value: object) -> int:
        """Return `value` as an int.

        Raises:
            ValueError: It is no integer within the bounds.
        """
        number = whole(value)
        if number is None or not self.low <= number <= self.high:
            raise ValueError(f"{self.name} = {value!r}, but it must be an integer in [{self.low}, {self.high}]")
        return number

    def encode(self, value: object) -> float:
        """Return `value` as it stands in a design array."""
        return float(self.check(value))

    def decode(self, number: float) -> int:
        """Return the value that stands in a design array."""
        return self.check(number)

    def to_unit(self, column: Array) -> Array:
        """Map a column (n,) of designs to the middles of their bins."""
        return _middle(column - self.low, self.count)

    def from_unit(self, column: Array) -> Array:
        """Map coordinates (n,) of the unit interval to a column of designs."""
        return self.low + _bin(column, self.count)

    def snap(self, column: Array) -> Array:
        """Move coordinates (n,) to the middles of their bins."""
        return _middle(_bin(column, self.count), self.count)

    def features(self, column: Array) -> Array:
        """Return what a Gaussian process should see of coordinates (n,): the middles of the bins, as (n, 1)."""
        return self.snap(column)[:, None]

    @property
    def feature_dim(self) -> int:
        """Number of features."""
        return 1


@dataclass(frozen=True)
class Categorical:
    """One of some choices that have no order.

    Attributes:
        name: Its name, unique in the space.
        choices: At least two different strings, finite numbers or booleans.
        nominal: Choice in the nominal design.
        fixed: Whether every design keeps the nominal choice.

    Raises:
        ValueError: The choices are too few, equal to one another or of another type, or the nominal value is
            none of them.
    """

    name: str
    choices: Sequence[Value]
    nominal: Value
    fixed: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.choices, str):
            raise ValueError(f"parameter {self.name}: choices is the string {self.choices!r}; it must be a list")
        choices = tuple(plain(c) for c in self.choices)
        bad = [
            c for c in choices if not isinstance(c, str | bool | int | float) or c in (math.inf, -math.inf) or c != c
        ]
        if bad:
            raise ValueError(f"parameter {self.name}: {bad} are no strings, finite numbers or booleans")
        if len(set(choices)) < max(len(choices), 1 if self.fixed else 2):
            raise ValueError(
                f"parameter {self.name}: it needs at least 2 different choices (True counts as 1, False as 0), "
                f"got {choices}; use BoxSpace.fix to hold a parameter"
            )
        object.__setattr__(self, "choices", choices)
        object.__setattr__(self, "nominal", self.check(self.nominal))

    @property
    def count(self) -> int:
        """Number of choices."""
        return len(self.choices)

    @property
    def low(self) -> int:
        """Index of the first choice."""
        return 0

    @property
    def high(self) -> int:
        """Index of the last choice."""
        return self.count - 1

    def check(self, value: object) -> Value:
        """Return the choice that `value` is.

        Raises:
            ValueError: It is none.
        """
        return self.choices[self._index(value)]

    def encode(self, value: object) -> float:
        """Return `value` as it stands in a design array: the index of the choice."""
        return float(self._index(value))

    def decode(self, number: float) -> Value:
        """Return the choice that stands in a design array."""
        if number not in range(self.count):
            raise ValueError(f"{self.name}: {number} is no index of one of the choices {self.choices}")
        return self.choices[int(number)]

    def to_unit(self, column: Array) -> Array:
        """Map a column (n,) of designs to the middles of their bins."""
        return _middle(column, self.count)

    def from_unit(self, column: Array) -> Array:
        """Map coordinates (n,) of the unit interval to a column of designs."""
        return _bin(column, self.count)

    def snap(self, column: Array) -> Array:
        """Move coordinates (n,) to the middles of their bins."""
        return _middle(_bin(column, self.count), self.count)

    def features(self, column: Array) -> Array:
        """Return what a Gaussian process should see of coordinates (n,), as (n, count).

        One column per choice, scaled so that two choices are as far apart as the ends of a continuous
        parameter: 1.
        """
        return np.eye(self.count)[_bin(column, self.count).astype(int)] * math.sqrt(0.5)

    @property
    def feature_dim(self) -> int:
        """Number of features."""
        return self.count

    def _index(self, value: object) -> int:
        value = plain(value)
        for index, choice in enumerate(self.choices):
            if value == choice and isinstance(value, bool) == isinstance(choice, bool):
                return index
        raise ValueError(f"{self.name} = {value!r}, but it must be one of {self.choices}")


Parameter = Continuous
"""The name `Continuous` had when there was no other kind."""

AnyParameter = Continuous | Integer | Categorical


def _check_order(p: Continuous | Integer) -> None:
    if not (p.low < p.high or (p.fixed and p.low == p.high)):
        raise ValueError(
            f"parameter {p.name}: lower bound {p.low} is not below upper bound {p.high}; "
            "use BoxSpace.fix to hold a parameter"
        )
    if not p.low <= p.nominal <= p.high:
        raise ValueError(f"parameter {p.name}: value {p.nominal} lies outside [{p.low}, {p.high}]")


def _bin(column: Array, count: int) -> Array:
    """Return in which of `count` equal bins of [0, 1] the coordinates (n,) lie."""
    return np.clip(np.floor(column * count), 0, count - 1)


def _middle(index: Array, count: int) -> Array:
    return (index + 0.5) / count
