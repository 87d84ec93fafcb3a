"""The exported network under onnxruntime: one thread, recurrent state fed back, no torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from deploy.bundles.manifest import Bundle
from deploy.errors import BundleError
from deploy.interfaces import PolicyOutput


class OnnxRuntime:
    """A `PolicyRuntime` on onnxruntime, on one CPU thread so that results repeat bit by bit."""

    def __init__(self, bundle: Bundle) -> None:
        """Open the network and compare its signature with the manifest.

        Raises:
            BundleError: onnxruntime refuses the file, or names or shapes differ from the manifest.
        """
        options = ort.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        path = bundle.path(bundle.policy.file)
        try:
            self._session = ort.InferenceSession(
                path.read_bytes(), sess_options=options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime has no public base class for its errors
            raise BundleError(f"{path}: onnxruntime cannot open it ({error}); export it again") from error
        self._states = bundle.policy.state
        self._outputs = [*bundle.policy.outputs, *(state.output for state in self._states)]
        inputs = {**bundle.policy.inputs, **{s.input: s.shape for s in self._states}}
        outputs = {**bundle.policy.outputs, **{s.output: s.shape for s in self._states}}
        for kind, wanted, found in (
            ("input", inputs, self._session.get_inputs()),
            ("output", outputs, self._session.get_outputs()),
        ):
            self._compare(f"{path}: {kind}", wanted, found, exact=kind == "input")
        self.reset()

    @staticmethod
    def _compare(what: str, wanted: dict[str, tuple[int, ...]], found: Sequence[ort.NodeArg], exact: bool) -> None:
        nodes = {node.name: node for node in found}
        odd = wanted.keys() ^ nodes.keys() if exact else wanted.keys() - nodes.keys()
        if odd:
            raise BundleError(
                f"{what}s are {sorted(nodes)}, the manifest says {sorted(wanted)}; export the bundle again"
            )
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

    def reset(self) -> None:
        """Put every recurrent state to zeros."""
        self._state = {s.input: np.zeros(s.shape, dtype=np.float32) for s in self._states}

    def step(self, obs: NDArray[np.float32]) -> PolicyOutput:
        """Run one tick.

        Args:
            obs: Observation, shape (P,).

        Returns:
            The action, shape (12,), and the estimated base velocity, shape (3,), where the network has one.
        """
        values = self._session.run(self._outputs, {"obs": obs[None], **self._state})
        named = {name: np.asarray(value) for name, value in zip(self._outputs, values, strict=True)}
        self._state = {s.input: named[s.output] for s in self._states}
        velocity = named.get("velocity")
        return PolicyOutput(
            action=named["action"][0].astype(np.float64),
            velocity=None if velocity is None else velocity[0].astype(np.float64),
        )
