"""Gradient steps that stop where a loss is not finite."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from distill.errors import TrainingDiverged


def descend(
    optimizer: torch.optim.Optimizer,
    loss: Callable[[], dict[str, Tensor]],
    updates: int,
    rate: float,
    max_grad_norm: float,
    iteration: int,
) -> dict[str, float]:
    """Take gradient steps on all that an optimiser holds.

    Args:
        optimizer: with one group of parameters.
        loss: draws a batch; its scalar terms by name, the sum to descend as "total" first.
        updates: number of steps.
        rate: learning rate.
        max_grad_norm: to which gradients are clipped.
        iteration: named in errors.

    Returns:
        The mean of every term over the steps: "loss" for the total, "<name>_loss" for the others.

    Raises:
        TrainingDiverged: a term is not finite.
    """
    (group,) = optimizer.param_groups
    group["lr"] = rate
    names: list[str] = []
    sums: Tensor | None = None
    for _ in range(updates):
        terms = loss()
        names = list(terms)
        values = torch.stack([term.detach() for term in terms.values()]).cpu()
        if not torch.isfinite(values).all():
            found = ", ".join(f"{name} {value:.3g}" for name, value in terms.items())
            raise TrainingDiverged(
                f"iteration {iteration}: the loss is not finite ({found}); "
                f"the last checkpoint is kept; start again with a learning rate below {rate:.1e}"
            )
        optimizer.zero_grad()
        terms["total"].backward()
        nn.utils.clip_grad_norm_(group["params"], max_grad_norm)
        optimizer.step()
        sums = values if sums is None else sums + values
    means = [] if sums is None else (sums / updates).tolist()
    return {"loss" if name == "total" else f"{name}_loss": mean for name, mean in zip(names, means, strict=True)}
