"""The end of a training that produced NaN or infinity."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor


class DivergedError(RuntimeError):
    """Training produced NaN or infinity, which has harmed neither the policy nor its optimiser.

    Attributes:
        what: where it was found: "observation", "action", "reward", "value" or "update".
        robots: those whose numbers are not finite, ascending; empty in an update, which mixes all.
        step: of the rollout, counted from 0, in which it was first found; None in an update.
        numbers: losses and gradient norm of the minibatch at fault; empty while collecting.
    """

    def __init__(
        self,
        message: str,
        what: str = "",
        robots: tuple[int, ...] = (),
        step: int | None = None,
        numbers: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__(message)
        self.what, self.robots, self.step, self.numbers = what, robots, step, dict(numbers or {})


def find_fault(what: str, name: str, values: Tensor, first_step: int = 0) -> DivergedError | None:
    """The error for what is not finite in `values` (T, N, ...), if anything is.

    Args:
        what: as in `DivergedError`.
        name: for people.
        values: the numbers.
        first_step: step of the rollout that row 0 belongs to.
    """
    bad = ~values.isfinite()
    if not bad.any():
        return None
    bad = bad.flatten(2).any(dim=2) if bad.dim() > 2 else bad
    step = first_step + int(bad.any(dim=1).nonzero()[0])
    robots = tuple(bad.any(dim=0).nonzero().flatten().tolist())
    some = ", ".join(map(str, robots[:5])) + (", ..." if len(robots) > 5 else "")
    return DivergedError(
        f"{name} is not finite for {len(robots)} of {bad.shape[1]} robots ({some}), first in step {step} of the "
        "rollout: check the bodies and the physics step",
        what,
        robots,
        step,
    )
