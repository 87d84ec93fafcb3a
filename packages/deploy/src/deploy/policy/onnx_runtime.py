"""The exported networks under onnxruntime: one thread each, no torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import onnxruntime as ort

from deploy.bundles.manifest import Bundle, Graph
from deploy.errors import BundleError
from deploy.interfaces import Image
from deploy.policy.networks import NetworkRuntime


class OnnxNetwork:
    """An ONNX file as a `Network`, on one CPU thread so that results repeat bit by bit."""

    def __init__(self, bundle: Bundle, graph: Graph) -> None:
        """Open the file and compare its signature with the manifest.

        Raises:
            BundleError: onnxruntime refuses the file, or names or shapes differ from the manifest.
        """
        options = ort.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        path = bundle.path(graph.file)
        try:
            self._session = ort.InferenceSession(
                path.read_bytes(), sess_options=options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime has no public base class for its errors
            raise BundleError(f"{path}: onnxruntime cannot open it ({error}); export it again") from error
        inputs = {**graph.inputs, **{s.input: s.shape for s in graph.state}}
        outputs = {**graph.outputs, **{s.output: s.shape for s in graph.state}}
        self._outputs = list(outputs)
        for kind, wanted, found in (
            ("input", inputs, self._session.get_inputs()),
            ("output", outputs, self._session.get_outputs()),
        ):
            _compare(f"{path}: {kind}", wanted, found, exact=kind == "input")

    def __call__(self, inputs: Mapping[str, Image]) -> dict[str, Image]:
        """Run once."""
        values = self._session.run(self._outputs, dict(inputs))
        return {name: np.asarray(value) for name, value in zip(self._outputs, values, strict=True)}


class OnnxRuntime(NetworkRuntime):
    """The default `PolicyRuntime`."""

    def __init__(self, bundle: Bundle) -> None:
        """Open the networks of a bundle.

        Raises:
            BundleError: onnxruntime refuses a file, or names or shapes differ from the manifest.
        """
        super().__init__(bundle, OnnxNetwork)


def _compare(what: str, wanted: dict[str, tuple[int, ...]], found: Sequence[ort.NodeArg], exact: bool) -> None:
    nodes = {node.name: node for node in found}
    odd = wanted.keys() ^ nodes.keys() if exact else wanted.keys() - nodes.keys()
    if odd:
        raise BundleError(f"{what}s are {sorted(nodes)}, the manifest says {sorted(wanted)}; export the bundle again")
    for name, shape in wanted.items():
        node = nodes[name]
        if node.type != "tensor(float)":
            raise BundleError(f"{what} {name} is {node.type}, not float32; export the bundle again")
        fits = len(node.shape) == len(shape) and all(
            not isinstance(have, int) or have == want for have, want in zip(node.shape, shape, strict=True)
        )
        if not fits:
            raise BundleError(
                f"{what} {name} has shape {node.shape}, the manifest says {list(shape)}; export the bundle again"
            )
