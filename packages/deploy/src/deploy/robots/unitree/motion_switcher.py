"""Asks the robot's own walking service to let go of the motors, and does not wait for ever."""

# pyright: reportMissingImports=false
from __future__ import annotations

import json
import time
from typing import Any

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from deploy.errors import RobotError
from deploy.robots.unitree.wire import Request, RequestHeader, RequestIdentity, Response

REQUEST, RESPONSE = "rt/api/motion_switcher/request", "rt/api/motion_switcher/response"
CHECK_MODE, RELEASE_MODE = 1001, 1003
_POLL_S = 0.01


class MotionSwitcher:
    """A client of the service `motion_switcher`."""

    def __init__(self, participant: DomainParticipant) -> None:
        self._reader = DataReader(participant, Topic(participant, RESPONSE, Response))
        self._writer = DataWriter(participant, Topic(participant, REQUEST, Request))

    def release(self, timeout_s: float, discovery_s: float = 1.0) -> str | None:
        """Release the active service, again until none is active.

        Args:
            timeout_s: Time for the service to let go, s.
            discovery_s: Time to find the robot's end, s.

        Returns:
            Name of the service that was active, "" for none; None where nothing answered, as in a simulator.

        Raises:
            RobotError: A service is still active after `timeout_s`, or may be.
        """
        if not self._is_served(discovery_s):
            return None
        end = time.monotonic() + timeout_s
        first = active = self._check(end)
        while active != "":  # no answer counts as active
            if time.monotonic() >= end:
                name = repr(first) if first else "that does not answer"
                raise RobotError(
                    f"Go2: the service {name} may still drive the motors {timeout_s:g} s after it was asked to let "
                    "go; end it in the vendor's app, with the robot lying down"
                )
            if active:
                self._call(RELEASE_MODE, end)
            time.sleep(_POLL_S)
            active = self._check(end)
            first = first or active
        return first

    def _is_served(self, discovery_s: float) -> bool:
        end = time.monotonic() + discovery_s
        while not self._writer.get_matched_subscriptions():
            if time.monotonic() > end:
                return False
            time.sleep(_POLL_S)
        return True

    def _check(self, end: float) -> str | None:
        """Name of the active service, "" for none; None where the answer does not say."""
        name = (self._call(CHECK_MODE, end) or {}).get("name")
        return name if isinstance(name, str) else None

    def _call(self, api_id: int, end: float) -> dict[str, Any] | None:
        """Ask, and wait for the answer to this very request, at most 1 s."""
        number = time.monotonic_ns()
        self._writer.write(Request(RequestHeader(RequestIdentity(number, api_id)), "{}"))
        give_up = min(end, time.monotonic() + 1.0)
        while time.monotonic() < give_up:
            for sample in self._reader.take(16):
                if isinstance(sample, Response) and sample.header.identity.id == number:
                    return _json(sample.data) if sample.header.status.code == 0 else None
            time.sleep(_POLL_S)
        return None


def _json(text: str) -> dict[str, Any]:
    try:
        found = json.loads(text or "{}")
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
