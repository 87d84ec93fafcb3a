"""What a Ray cluster can do, and whether it is still there."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping, Sequence
from typing import Any

from codesign_bo.errors import ExecutorError

_PATIENCE = 10.0  # s for a head that restarts; Ray itself ends the whole process after a minute without one
_ANSWER = 5.0  # s to connect to it
_POLL = 0.5  # s
_EVERY = 2.0  # s between two looks


class Pulse:
    """Tells a cluster that is gone from one that lost a worker, where Ray waits for ever or blames the task.

    Args:
        ray: The module, connected to the cluster.
    """

    def __init__(self, ray: Any) -> None:
        # through Ray's client the head is known only by the proxy's address
        proxy = os.environ.get("RAY_ADDRESS", "").removeprefix("ray://")
        self.address: str = getattr(ray.get_runtime_context(), "gcs_address", proxy)
        self._seen = time.monotonic()
        self.gone = False

    def feel(self, now: bool = False) -> None:
        """Look whether the cluster is there, unless that was done a moment ago and need not be `now`.

        Raises:
            ExecutorError: Its head does not answer any more.
        """
        start = time.monotonic()
        if not now and start - self._seen < _EVERY and not self.gone:
            return
        while not self._beats():
            if self.gone or time.monotonic() - start > _PATIENCE:
                self.gone = True
                raise ExecutorError(
                    f"the Ray cluster at {self.address} is gone: its head does not answer any more. No trial is to "
                    "blame, and those that ran stay open. Start the cluster again (`ray start --head`; RAY_ADDRESS "
                    "says where it is); then the same command goes on"
                )
            time.sleep(_POLL)
        self._seen = time.monotonic()

    def _beats(self) -> bool:
        """By a bare connection: Ray's own questions to a dead head hang, until Ray ends the process."""
        host, _, port = self.address.rpartition(":")
        if not port:  # nobody knows where it is
            return True
        try:
            socket.create_connection((host.strip("[]"), int(port)), _ANSWER).close()
        except OSError:
            return False
        return True


def check_resources(nodes: Sequence[Mapping[str, Any]], asked: Mapping[str, float], address: str) -> None:
    """Refuse what no node of a cluster has, for which Ray would wait for ever.

    Args:
        nodes: As `ray.nodes()` lists them.
        asked: Resource -> how much of it one evaluation needs; memory in bytes.
        address: Of the cluster, for messages.

    Raises:
        ExecutorError: Says what was asked for, and what the nodes have.
    """
    there = [node["Resources"] for node in nodes if node["Alive"]]
    if any(all(has.get(name, 0.0) >= need for name, need in asked.items()) for has in there):
        return
    found = sorted({_words({name: has.get(name, 0.0) for name in asked}) for has in there})
    raise ExecutorError(
        f"an evaluation needs {_words(asked)}, and no node of the Ray cluster at {address} has that: "
        f"{len(there)} with {'; '.join(found) or 'nothing'}. Ask for less, or start a node that has it"
    )


def _words(resources: Mapping[str, float]) -> str:
    return ", ".join(
        f"{amount / 1e9:.3g} GB of memory" if name == "memory" else f"{amount:g} {name}"
        for name, amount in resources.items()
    )
