"""The networks of a bundle behind one protocol, whatever library runs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deploy.bundles.manifest import Bundle, Graph
from deploy.interfaces import Image, PolicyOutput, Seen


class Network(Protocol):
    """A network without memory of its own."""

    def __call__(self, inputs: Mapping[str, Image]) -> dict[str, Image]:
        """All outputs by name, float32, from all inputs by name."""
        ...


class Recurrent:
    """A network and its recurrent state: what comes out of a step goes into the next one."""

    def __init__(self, network: Network, graph: Graph) -> None:
        self._network = network
        self._states = graph.state
        self.reset()

    def reset(self) -> None:
        """Put every recurrent state to zeros."""
        self._state = {state.input: np.zeros(state.shape, dtype=np.float32) for state in self._states}

    def __call__(self, inputs: Mapping[str, Image]) -> dict[str, Image]:
        """All outputs by name; the state has moved on."""
        outputs = self._network({**inputs, **self._state})
        self._state = {state.input: outputs[state.output] for state in self._states}
        return outputs


class NetworkRuntime:
    """A `PolicyRuntime` of the networks that a bundle holds."""

    def __init__(self, bundle: Bundle, open_network: Callable[[Bundle, Graph], Network]) -> None:
        """Open the policy and, where it sees, its depth encoder.

        Raises:
            BundleError: A network cannot be opened or is not the one of the manifest.
        """
        self._policy = Recurrent(open_network(bundle, bundle.policy), bundle.policy)
        graph = None if bundle.depth is None else bundle.depth.graph
        self._depth = None if graph is None else Recurrent(open_network(bundle, graph), graph)
        self._fed = [name for name in bundle.policy.inputs if name != "obs"]

    def reset(self) -> None:
        """Put every recurrent state to zeros."""
        self._policy.reset()
        if self._depth is not None:
            self._depth.reset()

    def step(self, obs: NDArray[np.float32], seen: Seen | None = None) -> PolicyOutput:
        """One tick of the policy.

        Args:
            obs: Observation, shape (P,).
            seen: What a policy with a depth encoder has in use.

        Returns:
            The action, shape (12,), and the estimated base velocity, shape (3,), where the network has one.
        """
        inputs = {"obs": obs[None]}
        for name in self._fed:
            inputs[name] = getattr(seen, name)[None]
        outputs = self._policy(inputs)
        velocity = outputs.get("velocity")
        return PolicyOutput(
            action=outputs["action"][0].astype(np.float64),
            velocity=None if velocity is None else velocity[0].astype(np.float64),
        )

    def see(self, image: Image, obs: NDArray[np.float32]) -> tuple[Image, Image]:
        """One image through the depth encoder: terrain latent (S,) and headings (K,), rad."""
        assert self._depth is not None, "this policy is blind"
        outputs = self._depth({"depth": image[None], "obs": obs[None]})
        return outputs["terrain"][0], outputs["heading"][0]
