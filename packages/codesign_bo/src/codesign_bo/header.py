"""What identifies a study: its space and settings."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields

from codesign_bo.space import ParameterSignature


@dataclass(frozen=True)
class Header:
    """What makes a study this study; a file with another header is refused.

    Attributes:
        space: Signature of the space.
        seed: Seed of the study.
        n_init: Trials before the surrogate takes over.
        maximize: Whether the objective is to be maximised.
    """

    space: list[ParameterSignature]
    seed: int
    n_init: int
    maximize: bool

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
    there = {p["name"]: p for p in stored.space}
    here = {p["name"]: p for p in given.space}
    words += [f"parameter {name} is only there" for name in there if name not in here]
    words += [f"parameter {name} is only here" for name in here if name not in there]
    for name in (n for n in there if n in here and there[n] != here[n]):
        words += [
            f"{name}.{k} is {there[name][k]} there, {v} here" for k, v in here[name].items() if there[name][k] != v
        ]
    return words or ["the parameters are in another order"]
