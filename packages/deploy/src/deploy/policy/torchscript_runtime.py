"""The exported networks as TorchScript, for machines that have torch anyway; needs the extra `torch`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from deploy.bundles.manifest import Bundle, Graph
from deploy.errors import BundleError, DeployError
from deploy.interfaces import Image
from deploy.policy.networks import NetworkRuntime


class TorchScriptNetwork:
    """A TorchScript file as a `Network`, on the CPU. Its arguments and results have the order of the manifest."""

    def __init__(self, bundle: Bundle, graph: Graph) -> None:
        """Load the file.

        Raises:
            BundleError: The bundle has no such file, or torch refuses it.
            DeployError: torch is missing.
        """
        try:
            import torch
        except ImportError as error:
            raise DeployError("TorchScript needs torch: pip install 'legged-deploy[torch]', or use onnx") from error
        if graph.torchscript is None:
            raise BundleError(f"{bundle.root}: holds no TorchScript of {graph.file}; export it again, or use onnx")
        path = bundle.path(graph.torchscript)
        try:
            with warnings.catch_warnings():
                # deprecated, and all that the LibTorch of older robots can load
                warnings.filterwarnings("ignore", message=r"`torch\.jit\.", category=DeprecationWarning)
                self._module = torch.jit.load(str(path), map_location="cpu").eval()
        except (RuntimeError, ValueError) as error:
            raise BundleError(f"{path}: torch cannot load it ({error}); export it again") from error
        self._torch: Any = torch
        self._path = path
        self._inputs = [*graph.inputs, *(state.input for state in graph.state)]
        outputs = {**graph.outputs, **{state.output: state.shape for state in graph.state}}
        self._outputs = list(outputs)
        self._shapes = list(outputs.values())

    def __call__(self, inputs: Mapping[str, Image]) -> dict[str, Image]:
        """Run once.

        Raises:
            BundleError: Arguments or results are not those of the manifest.
        """
        arguments = [self._torch.from_numpy(inputs[name]) for name in self._inputs]
        try:
            with self._torch.no_grad():
                values = self._module(*arguments)
        except RuntimeError as error:
            raise BundleError(
                f"{self._path}: does not take {', '.join(self._inputs)} ({error}); export it again"
            ) from error
        found = [tuple(value.shape) for value in values]
        if found != self._shapes:
            raise BundleError(
                f"{self._path}: gives results of shapes {found}, the manifest says {self._shapes} "
                f"({', '.join(self._outputs)}); export the bundle again"
            )
        return {name: value.numpy() for name, value in zip(self._outputs, values, strict=True)}


class TorchScriptRuntime(NetworkRuntime):
    """A `PolicyRuntime` on torch."""

    def __init__(self, bundle: Bundle) -> None:
        """Load the networks of a bundle.

        Raises:
            BundleError: The bundle has no TorchScript, or torch refuses it.
            DeployError: torch is missing.
        """
        super().__init__(bundle, TorchScriptNetwork)
