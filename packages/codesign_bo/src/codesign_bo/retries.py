"""Which failures are tried again, with the same design and seed, and which are final.

- `lost`: up to `retries` times, for the machine failed, which says nothing about the design.
- `diverged`: once, for a GPU need not repeat itself to the last bit; twice is the design's fault.
- `timeout`: never, for the same evaluation would take as long again. But if its deadline has passed, the whole
  run was out of time: then the trial stays open for the next run, at no cost.
- `crash`, `infeasible`: never.

An evaluation that the coordinator itself interrupted or that died with it is always dispatched again. A failure
that comes late, when another attempt has taken over, settles nothing: that attempt decides.
"""

from __future__ import annotations

from collections.abc import Sequence

from codesign_bo.interfaces import Status

RETRIES = 2
"""Default number of further attempts after an evaluation was lost."""


def is_final(status: Status, others: Sequence[str], retries: int, out_of_time: bool) -> bool:
    """Return whether the outcome of an attempt settles its evaluation.

    Args:
        status: The outcome.
        others: States of the other attempts since the evaluation was last settled.
        retries: Further attempts allowed after a loss.
        out_of_time: Whether the deadline of the attempt has passed.
    """
    if status in ("ok", "stopped"):
        return True
    if "running" in others:
        return False
    if status == "lost":
        return others.count("lost") >= retries
    if status == "diverged":
        return retries == 0 or "diverged" in others
    return not (status == "timeout" and out_of_time)
