"""Which simulator to use, and where it runs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch

from locorl.interfaces import Array, BodyBatch
from locorl.simulation.cpu import CpuSimulator
from locorl.simulation.simulator import Simulator


@dataclass(frozen=True)
class SimulatorConfig:
    """Backend of the physics."""

    backend: str = "cpu"
    """`cpu`: MuJoCo's C++ thread pool, float64. `warp`: MuJoCo Warp, float32 (extra `gpu`)."""
    device: str = "cpu"
    """Of the `warp` backend: `cuda`, `cuda:1`, ..., or `cpu`, which is for tests: it is slow. Of several processes that
    torchrun starts on a machine, `cuda` gives each a GPU of its own."""
    threads: int | None = None
    """Worker threads of the `cpu` backend; None takes every core that this process may use."""
    contacts: int = 64
    """Contacts per robot for which the `warp` backend reserves memory; a quadruped of 13 boxes that lies flat
    has up to 56. `Simulator.overflows` tells whether it was too few."""

    def __post_init__(self) -> None:
        """Refuse what no simulator can be."""
        if self.backend not in ("cpu", "warp"):
            raise ValueError(f"simulator backend must be 'cpu' or 'warp', got '{self.backend}'")
        if self.backend == "cpu" and self.device != "cpu":
            raise ValueError(f"the 'cpu' simulator runs on the CPU; for device '{self.device}' take backend 'warp'")
        if self.contacts < 1 or (self.threads is not None and self.threads < 1):
            raise ValueError(f"SimulatorConfig: contacts and threads must be at least 1, got {self}")

    def here(self, threads: int | None = None) -> SimulatorConfig:
        """The same for this process: `cuda` is the GPU of its LOCAL_RANK; `threads`, if given, replace its own."""
        rank = os.environ.get("LOCAL_RANK")
        device = f"cuda:{rank}" if self.device == "cuda" and rank is not None else self.device
        return replace(self, device=device, threads=self.threads if threads is None else threads)


def find_device(config: SimulatorConfig) -> torch.device:
    """Where the simulator's tensors live.

    Raises:
        ValueError: this machine, or this PyTorch, has no such device.
    """
    try:
        device = torch.device(config.device)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise ValueError(
            f"PyTorch finds no device '{config.device}' here: take 'cpu', or install the driver of a GPU and a PyTorch "
            "that uses it"
        ) from error
    return device


def make_simulator(
    config: SimulatorConfig,
    bodies: BodyBatch,
    substeps: int,
    feet: Sequence[str] = (),
    extra_fields: Mapping[str, Array] | None = None,
) -> Simulator:
    """The simulator that `config` asks for.

    Args:
        config: backend and device.
        bodies: one body per simulation.
        substeps: physics steps per control period.
        feet: names of the sites that `foot_position` shows.
        extra_fields: further per-simulation model fields, (N, *field shape), such as friction.

    Raises:
        ModuleNotFoundError: the backend is not installed; the message says how to install it.
    """
    if config.backend == "cpu":
        return CpuSimulator(bodies, substeps, extra_fields, config.threads, feet)
    # the import takes seconds, and the package is optional
    from locorl.simulation.warp import WarpSimulator

    return WarpSimulator(bodies, substeps, extra_fields, config.device, feet, config.contacts)
