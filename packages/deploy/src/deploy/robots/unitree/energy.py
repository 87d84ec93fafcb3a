"""The energy of a Go2 at the rate of its states, in a process of its own.

To decode 500 messages a second in Python takes a good part of a core; in a thread it would take it from the loop.

    python -m deploy.robots.unitree.energy DOMAIN INTERFACE       # records on stdout, until nobody reads them
"""

# pyright: reportMissingImports=false, reportIndexIssue=false
# To the checker an IDL array is no sequence.
from __future__ import annotations

import os
import struct
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from deploy.interfaces import EnergyReading
from deploy.robots.energy_meter import EnergyMeter
from deploy.robots.unitree.domain import join
from deploy.robots.unitree.messages import JOINTS, STATES
from deploy.robots.unitree.wire import LowState

_RECORD = struct.Struct(f"<{JOINTS}ddq")
"""Work of each joint, J; peak since the record before, W; states."""
_BATCH, _POLL_S = 256, 0.004
_SILENT_S = 1.0
"""A process that writes nothing for so long counts nothing."""


class EnergyProcess:
    """Counts while it runs; `read` neither waits nor fails."""

    def __init__(self, domain: int, interface: str) -> None:
        command = [sys.executable, "-m", __name__, str(domain), interface]
        # a session of its own: Ctrl-C is for the loop alone
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, start_new_session=True
        )
        assert self._process.stdout is not None
        self._pipe = self._process.stdout.fileno()
        os.set_blocking(self._pipe, False)
        self._bytes = b""
        self._latest: EnergyReading | None = None
        self._heard = time.monotonic()

    def read(self) -> EnergyReading | None:
        """What was counted so far; None before the first state, and as soon as the process is gone or stuck."""
        try:
            while block := os.read(self._pipe, 1 << 16):
                self._bytes += block
                self._heard = time.monotonic()
            self._latest = None  # end of file
        except BlockingIOError:
            if time.monotonic() - self._heard > _SILENT_S:
                return None
            whole = len(self._bytes) // _RECORD.size * _RECORD.size
            records = list(_RECORD.iter_unpack(self._bytes[:whole]))
            self._bytes = self._bytes[whole:]
            peak = max((record[JOINTS] for record in records), default=0.0)
            if records and records[-1][-1] > 0:
                self._latest = EnergyReading(np.array(records[-1][:JOINTS]), peak, records[-1][-1])
            elif self._latest is not None:
                self._latest = replace(self._latest, peak_pos_w=peak)
        return self._latest

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


def count(domain: int, interface: str) -> None:
    """Count the states of a robot and write records to stdout, until nobody reads them."""
    participant = join(domain, interface)
    states = DataReader(participant, Topic(participant, STATES, LowState), _ALL)
    meter, last, written = EnergyMeter(JOINTS), None, 0.0
    while True:
        taken = [sample for sample in states.take(_BATCH) if isinstance(sample, LowState)]
        for sample in taken:
            if last is not None and (elapsed_ms := (sample.tick - last) % 2**32) < 2**31:
                motors = sample.motor_state[:JOINTS]
                dq, tau = np.array([[motor.dq, motor.tau_est] for motor in motors]).T
                meter.add(dq, tau, elapsed_ms * 1e-3)
            last = sample.tick
        now = time.monotonic()
        if taken or now - written > _SILENT_S / 4:
            found = meter.read()
            os.write(1, _RECORD.pack(*found.joint_energy_pos_j, found.peak_pos_w, found.states))
            written = now
        if not taken:
            time.sleep(_POLL_S)


_ALL = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(_BATCH))

if __name__ == "__main__":
    with suppress(BrokenPipeError):
        count(int(sys.argv[1]), sys.argv[2])
