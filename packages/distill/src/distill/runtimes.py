"""Three ways to run a student tick by tick: eager torch, TorchScript and ONNX Runtime.

All share one signature: `forward(obs, *state_in) -> (action, velocity, *state_out)`, batch 1.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import onnxruntime
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

Array = NDArray[np.float32]
Shape = Sequence[int]
Network: TypeAlias = Callable[[list[Array]], list[Array]]
"""Inputs in order -> outputs in order, batch 1."""


class Output(NamedTuple):
    """One tick: action (12,), estimated base velocity (3,) in m/s."""

    action: Array
    velocity: Array


class PolicyRuntime(ABC):
    """A policy with its recurrent state, which starts as zeros."""

    def __init__(self, state_shapes: Sequence[Shape]) -> None:
        self._shapes = [tuple(shape) for shape in state_shapes]
        self.reset()

    def reset(self) -> None:
        """Begin a new episode."""
        self._state: list[Array] = [np.zeros(shape, dtype=np.float32) for shape in self._shapes]

    def step(self, obs: Array) -> Output:
        """Advance one tick on the observation (P,)."""
        action, velocity, *self._state = self._forward([obs[None], *self._state])
        return Output(action[0], velocity[0])

    @abstractmethod
    def _forward(self, inputs: list[Array]) -> list[Array]: ...


class TorchRuntime(PolicyRuntime):
    """A torch module on the CPU: eager, or one read by `load_torchscript`."""

    def __init__(self, module: nn.Module, state_shapes: Sequence[Shape]) -> None:
        super().__init__(state_shapes)
        self._network = torch_network(module)

    def _forward(self, inputs: list[Array]) -> list[Array]:
        return self._network(inputs)


class OnnxRuntime(PolicyRuntime):
    """An ONNX file in onnxruntime on one CPU thread."""

    def __init__(self, path: Path, state_shapes: Sequence[Shape]) -> None:
        super().__init__(state_shapes)
        self._network = onnx_network(path)

    def _forward(self, inputs: list[Array]) -> list[Array]:
        return self._network(inputs)


def torch_network(module: nn.Module) -> Network:
    """A torch module on the CPU as a function of arrays."""

    @torch.no_grad()
    def run(inputs: list[Array]) -> list[Array]:
        outputs: tuple[Tensor, ...] = module(*(torch.from_numpy(array) for array in inputs))
        return [output.numpy() for output in outputs]

    return run


def onnx_network(path: Path) -> Network:
    """An ONNX file as a function of arrays, run by onnxruntime on one CPU thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    names = [item.name for item in session.get_inputs()]

    def run(inputs: list[Array]) -> list[Array]:
        return [np.asarray(output) for output in session.run(None, dict(zip(names, inputs, strict=True)))]

    return run


def replay(runtime: PolicyRuntime, obs: Array, reset: NDArray[np.bool_]) -> Output:
    """Feed recorded observations (T, P), clearing the state where `reset` (T,) says so.

    Returns:
        Actions (T, 12) and velocities (T, 3).
    """
    outputs: list[Output] = []
    for frame, clear in zip(obs, reset, strict=True):
        if clear:
            runtime.reset()
        outputs.append(runtime.step(frame))
    actions, velocities = zip(*outputs, strict=True)
    return Output(np.stack(actions), np.stack(velocities))


def save_torchscript(module: nn.Module, example: tuple[Tensor, ...], path: Path) -> None:
    """Trace `module` on `example` inputs and write it as TorchScript."""
    with _torchscript():
        torch.jit.save(torch.jit.trace(module, example), path)


def load_torchscript(path: Path) -> nn.Module:
    """Read a TorchScript file onto the CPU."""
    with _torchscript():
        return torch.jit.load(path, map_location="cpu")


@contextmanager
def _torchscript() -> Iterator[None]:
    """Silence torch's notice that TorchScript is deprecated: older robots can load nothing else."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"`torch\.jit\.", category=DeprecationWarning)
        yield
