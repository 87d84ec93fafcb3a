"""The checksum without which a Go2 ignores a command.

CRC-32 (polynomial 0x04C11DB7, start 0xFFFFFFFF, most significant bit first, no final inversion) over the 32-bit
words of the message as a C structure on a little-endian machine, without its last word, the checksum itself.
"""

# pyright: reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportGeneralTypeIssues=false, reportOperatorIssue=false
# To the checker an IDL array is no sequence.
from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deploy.robots.unitree.wire import LowCmd

_MOTOR = "B3x5f3I"
_LAYOUT = struct.Struct("<4B4IH2x" + _MOTOR * 20 + "4B" + "40B12B2BBx" + "I")
"""`LowCmd` as a C structure up to its checksum; x are the gaps that alignment leaves."""

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc32(data: bytes) -> int:
    """Checksum of `data`, whose length is a multiple of 4.

    zlib has the same polynomial with the least significant bit first and an inversion at the end, so the bits are
    turned round on the way in and out.
    """
    words = struct.unpack(f"<{len(data) // 4}I", data)
    mirrored = struct.pack(f">{len(words)}I", *words).translate(_REVERSED)
    return int(f"{zlib.crc32(mirrored) ^ 0xFFFFFFFF:032b}"[::-1], 2)


def low_cmd_crc(command: LowCmd) -> int:
    """Checksum of a command."""
    motors = [value for m in command.motor_cmd for value in (m.mode, m.q, m.dq, m.tau, m.kp, m.kd, *m.reserve)]
    return crc32(
        _LAYOUT.pack(
            *command.head,
            command.level_flag,
            command.frame_reserve,
            *command.sn,
            *command.version,
            command.bandwidth,
            *motors,
            command.bms_cmd.off,
            *command.bms_cmd.reserve,
            *command.wireless_remote,
            *command.led,
            *command.fan,
            command.gpio,
            command.reserve,
        )
    )
