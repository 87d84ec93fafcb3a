"""Several processes that train one policy, each on robots of its own."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor


class Processes:
    """The processes of one training, as `torchrun` starts them; every method is called by all of them.

    Args:
        device: where their tensors are: a CPU takes gloo, CUDA nccl.
        timeout: seconds after which a process gives up waiting for the others.

    Raises:
        ValueError: this process was not started by `torchrun`, or by nothing that sets what it sets.
    """

    def __init__(self, device: torch.device | str = "cpu", timeout: float = 600.0) -> None:
        missing = [name for name in ("RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT") if name not in os.environ]
        if missing:
            raise ValueError(f"{', '.join(missing)} not set: start the processes with torchrun --nproc-per-node N")
        self.device = torch.device(device)
        backend = "nccl" if self.device.type == "cuda" else "gloo"
        if self.device.type == "cuda":  # where nccl, and Python objects on their way, find room
            torch.cuda.set_device(self.device)
        dist.init_process_group(backend, timeout=timedelta(seconds=timeout))
        self.rank, self.size = dist.get_rank(), dist.get_world_size()

    @classmethod
    def from_environment(cls, device: torch.device | str = "cpu") -> Processes | None:
        """The processes that `torchrun` started; None if there is no other than this one."""
        return cls(device) if int(os.environ.get("WORLD_SIZE", "1")) > 1 else None

    @property
    def first(self) -> bool:
        """Whether this is the process that writes files and shows progress."""
        return self.rank == 0

    def share(self, num_envs: int) -> int:
        """Robots that each process simulates.

        Raises:
            ValueError: they cannot be shared out evenly, which would weigh their gradients wrongly.
        """
        if num_envs % self.size:
            raise ValueError(f"{num_envs} robots cannot be shared out among {self.size} processes: take a multiple")
        return num_envs // self.size

    def average(self, tensors: Sequence[Tensor]) -> None:
        """Replace each tensor by its mean over the processes, in one exchange."""
        flat = torch.cat([tensor.flatten() for tensor in tensors])
        dist.all_reduce(flat)
        flat /= self.size
        for tensor, mean in zip(tensors, flat.split([tensor.numel() for tensor in tensors]), strict=True):
            tensor.copy_(mean.view_as(tensor))

    def average_metrics(self, metrics: Mapping[str, float]) -> dict[str, float]:
        """Mean of each metric over the processes."""
        values = torch.tensor(list(metrics.values()), dtype=torch.float64, device=self.device)
        self.average([values])
        return dict(zip(metrics, values.tolist(), strict=True))

    def any(self, flag: bool) -> bool:
        """Whether `flag` is set in some process."""
        count = torch.tensor(float(flag), device=self.device)
        dist.all_reduce(count)
        return count.item() > 0.0

    def broadcast(self, tensors: Iterable[Tensor]) -> None:
        """Replace tensors by those of the first process."""
        with torch.no_grad():
            for tensor in tensors:
                dist.broadcast(tensor, src=0)

    def all(self, values: Tensor) -> Tensor:
        """The rows (n, ...) of every process in order, (size * n, ...)."""
        parts = [torch.empty_like(values) for _ in range(self.size)]
        dist.all_gather(parts, values.contiguous())
        return torch.cat(parts)

    def collect(self, content: Any) -> list[Any]:
        """What each process has, in order, at the first process; nothing at the others."""
        everyone: list[Any] | None = [None] * self.size if self.first else None
        dist.gather_object(content, everyone, dst=0)
        return everyone or []

    def close(self) -> None:
        """Leave; a process that ends without it is missed by the others."""
        dist.destroy_process_group()


def mean_and_std(values: Tensor, group: Processes | None) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation () of all values of all processes, as `Tensor.mean` and `Tensor.std` define them."""
    if group is None:
        return values.mean(), values.std()
    # means of x and x^2 over equally many values each; double, as their difference may be small
    wide = values.double()
    moments = torch.stack((wide.mean(), wide.square().mean()))
    group.average([moments])
    mean, square = moments
    count = values.numel() * group.size
    variance = (square - mean.square()).clamp(min=0.0) * count / (count - 1)
    return mean.to(values.dtype), variance.sqrt().to(values.dtype)
