"""What identifies a study: its space and settings."""

from __future__ import annotations

import json
import operator
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal

from codesign_bo.space import SignatureEntry

Direction = Literal["maximize", "minimize"]


@dataclass(frozen=True)
class Header:
    """What makes a study this study; a file with another header is refused.

    Attributes:
        space: Signature of the space.
        seed: Seed of the study.
        n_init: Trials before the surrogate takes over.
        maximize: Whether the objective is to be maximised.
        objectives: Further objectives: names of `EvalResult.extras` and their directions.
    """

    space: list[SignatureEntry]
    seed: int
    n_init: int
    maximize: bool
    objectives: Mapping[str, Direction] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "seed", operator.index(self.seed))  # numpy's integers too
        object.__setattr__(self, "n_init", operator.index(self.n_init))
        object.__setattr__(self, "maximize", bool(self.maximize))
        object.__setattr__(self, "objectives", dict(self.objectives))
        bad = {name: way for name, way in self.objectives.items() if way not in ("maximize", "minimize")}
        if bad:
            raise ValueError(f"objectives {bad}: choose 'maximize' or 'minimize' for each")

    def to_json(self) -> str:
        """Return the header as JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Header:
        """Return the header that `to_json` wrote.

        Raises:
            ValueError: The text is no header.
        """
        try:
            return cls(**json.loads(text))
        except TypeError as error:
            raise ValueError(f"not a study header: {text[:200]}") from error


def differences(stored: Header, given: Header) -> list[str]:
    """Return in words what differs between the header of a file and the one asked for."""
    words: list[str] = []
    for key in (f.name for f in fields(Header) if f.name != "space"):
        old, new = getattr(stored, key), getattr(given, key)
        if old != new:
            words.append(f"{key} is {old} there, {new} here")
    there: dict[str, Mapping[str, Any]] = {entry["name"]: entry for entry in stored.space}
    here: dict[str, Mapping[str, Any]] = {entry["name"]: entry for entry in given.space}
    words += [f"{_kind(entry)} {name} is only there" for name, entry in there.items() if name not in here]
    words += [f"{_kind(entry)} {name} is only here" for name, entry in here.items() if name not in there]
    for name in (n for n in there if n in here and there[n] != here[n]):
        old, new = there[name], here[name]
        keys = dict.fromkeys((*old, *new))
        words += [f"{name}.{k} is {old.get(k)} there, {new.get(k)} here" for k in keys if old.get(k) != new.get(k)]
    return words or ["the parameters are in another order"]


def _kind(entry: Mapping[str, Any]) -> str:
    return "constraint" if entry.get("kind") == "linear" else "parameter"
