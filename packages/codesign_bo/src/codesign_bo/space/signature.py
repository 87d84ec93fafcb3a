"""A space as JSON-ready values, for files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NotRequired, TypedDict

from codesign_bo.space.constraints import LinearConstraint
from codesign_bo.space.parameters import AnyParameter, Categorical, Continuous, Integer
from codesign_bo.space.values import Value


class SignatureEntry(TypedDict):
    """A parameter or a linear constraint as stored in files; names are unique.

    The keys are the attributes of the class that `kind` stands for. A continuous parameter has no `kind`, and
    `log` only when it is on a log scale; the name of a constraint is itself in words.
    """

    name: str
    kind: NotRequired[str]
    low: NotRequired[float | None]
    high: NotRequired[float | None]
    choices: NotRequired[list[Value]]
    nominal: NotRequired[Value]
    fixed: NotRequired[bool]
    log: NotRequired[bool]
    coefficients: NotRequired[dict[str, float]]


ParameterSignature = SignatureEntry

_KINDS = {"continuous": Continuous, "integer": Integer, "categorical": Categorical, "linear": LinearConstraint}


def write_signature(
    parameters: Sequence[AnyParameter], constraints: Sequence[LinearConstraint]
) -> list[SignatureEntry]:
    """Return the entries of a space, the parameters first."""
    return [_write_parameter(p) for p in parameters] + [
        SignatureEntry(name=str(c), kind="linear", coefficients=dict(c.coefficients), low=c.low, high=c.high)
        for c in constraints
    ]


def _write_parameter(p: AnyParameter) -> SignatureEntry:
    if isinstance(p, Categorical):
        return SignatureEntry(
            name=p.name, kind="categorical", choices=list(p.choices), nominal=p.nominal, fixed=p.fixed
        )
    entry = SignatureEntry(name=p.name, low=p.low, high=p.high, nominal=p.nominal, fixed=p.fixed)
    if isinstance(p, Integer):
        entry["kind"] = "integer"
    elif p.log:
        entry["log"] = True
    return entry


def read_signature(
    entries: Iterable[SignatureEntry],
) -> tuple[tuple[AnyParameter, ...], tuple[LinearConstraint, ...]]:
    """Return the parameters and constraints of a space.

    Raises:
        ValueError: An entry is of an unknown kind, or lacks or exceeds what its kind has.
    """
    parameters: list[AnyParameter] = []
    constraints: list[LinearConstraint] = []
    for entry in entries:
        fields: dict[str, Any] = dict(entry)
        kind = fields.pop("kind", "continuous")
        if kind not in _KINDS:
            raise ValueError(f"{fields.get('name')} is a {kind!r}; this codesign_bo knows {list(_KINDS)}")
        if kind == "linear":
            del fields["name"]
        try:
            made = _KINDS[kind](**fields)
        except TypeError as error:
            raise ValueError(f"{entry} does not describe a {kind} entry of a space ({error})") from error
        if isinstance(made, LinearConstraint):
            constraints.append(made)
        else:
            parameters.append(made)
    return tuple(parameters), tuple(constraints)
