"""Torch's threads: fewer for little work, and backward passes of a minibatch in parts, side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from types import TracebackType

import torch
from torch import Tensor, nn

Loss = Callable[[Tensor], tuple[Tensor, dict[str, Tensor]]]
"""Loss () of the transitions in these rows (B,), a mean over them, and numbers () that are means too."""

_MOST = 4
"""More parts would wait for Python's lock instead of each other."""

_ROWS_PER_THREAD = 2048
"""For fewer, waking another thread in each layer takes longer than it helps (measured at 1024 rows on two cores)."""


@contextmanager
def threads_for(rows: int) -> Iterator[None]:
    """As many of torch's threads as networks on `rows` rows can use."""
    threads = torch.get_num_threads()
    torch.set_num_threads(max(1, min(threads, rows // _ROWS_PER_THREAD)))
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class Backward:
    """Leaves gradients in `Parameter.grad`, while it is entered.

    Torch's threads share every operation on a CPU, and wait for each other hundreds of times in a step. With a part
    of the minibatch for each they meet once. The parts' gradients are added in order: equal threads, equal bits.

    Args:
        parameters: of which the gradient is taken.
        parts: into which a minibatch is split; torch's threads are shared out among them.
    """

    def __init__(self, parameters: Sequence[nn.Parameter], parts: int) -> None:
        self._parameters, self._parts = parameters, parts
        self._stack = ExitStack()

    @classmethod
    def on(cls, device: torch.device, parameters: Sequence[nn.Parameter]) -> Backward:
        """As many parts as suit the device and the number of torch's threads."""
        return cls(parameters, min(_MOST, torch.get_num_threads()) if device.type == "cpu" else 1)

    def __enter__(self) -> Backward:
        """Start the threads."""
        if self._parts > 1:
            threads = torch.get_num_threads()
            self._stack.callback(torch.set_num_threads, threads)
            torch.set_num_threads(max(1, threads // self._parts))
            self._pool = self._stack.enter_context(ThreadPoolExecutor(self._parts))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End them."""
        self._stack.close()

    def __call__(self, loss: Loss, rows: Tensor) -> dict[str, Tensor]:
        """Put the gradient of `loss(rows)` in place of the one before; returns its numbers."""
        if self._parts == 1:
            for parameter in self._parameters:
                parameter.grad = None
            whole, numbers = loss(rows)
            whole.backward()
            return numbers

        def part_of(part: Tensor) -> tuple[tuple[Tensor | None, ...], dict[str, Tensor]]:
            share = len(part) / len(rows)
            value, numbers = loss(part)
            gradient = torch.autograd.grad(share * value, self._parameters, allow_unused=True)
            return gradient, {name: share * number.detach() for name, number in numbers.items()}

        found = list(self._pool.map(part_of, rows.tensor_split(self._parts)))
        for parameter, gradients in zip(self._parameters, zip(*(each for each, _ in found), strict=True), strict=True):
            parts = [gradient for gradient in gradients if gradient is not None]
            parameter.grad = torch.stack(parts).sum(dim=0) if parts else None
        return {name: torch.stack([numbers[name] for _, numbers in found]).sum() for name in found[0][1]}
