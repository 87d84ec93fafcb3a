"""Descent along clipped gradients, by one process or by several together."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor, nn

from locorl.learning.distributed import Processes
from locorl.learning.divergence import DivergedError


class Descent:
    """Adam, its gradients clipped and averaged over the processes that train together.

    Args:
        parameters: trained; every process starts with those of the first.
        learning_rate: of Adam.
        max_norm: gradients are clipped to this norm.
        group: the processes; None if there is one.
    """

    def __init__(
        self, parameters: Iterable[nn.Parameter], learning_rate: float, max_norm: float, group: Processes | None = None
    ) -> None:
        self.parameters = list(parameters)
        self.max_norm, self.group = max_norm, group
        self.optimizer = torch.optim.Adam(self.parameters, lr=learning_rate, fused=True)
        if group is not None:
            group.broadcast(self.parameters)

    def settle(self, **numbers: Tensor) -> dict[str, float]:
        """Finish the gradients that `backward` has left: average, check and clip them; the step itself is the caller's.

        Args:
            numbers: () each, such as losses; averaged over the processes too. Everything that Python has to know
                of a minibatch is read from the device here, at once.

        Returns:
            The numbers, and `gradient_norm` before clipping.

        Raises:
            DivergedError: one of them is not finite; no parameter has changed.
        """
        values = torch.stack(list(numbers.values())).detach()
        if self.group is not None:
            self.group.average([values, *(p.grad for p in self.parameters if p.grad is not None)])
        norm = nn.utils.clip_grad_norm_(self.parameters, self.max_norm, foreach=True)
        names = (*numbers, "gradient_norm")
        found = dict(zip(names, torch.cat((values, norm[None])).tolist(), strict=True))
        bad = [name for name, value in found.items() if not math.isfinite(value)]
        if bad:
            raise DivergedError(
                f"{', '.join(bad)} not finite in an update; the policy is as it was before that minibatch: "
                "lower the learning rate",
                "update",
                numbers=found,
            )
        return found
