"""Packet logs of OpenC3 COSMOS 5: how they begin, and their entries written.

A log is ``COSMOS5_`` and entries: u32 length of what follows, u16 flags, and the entry's own data,
all from the most significant byte on.  The flags' upper four bits say what the entry is: 1 a target
(its name), 2 a packet (u16 target index, name), 3 a raw packet, 4 a packet as JSON or CBOR, 5 an
offset in the message broker, 6 a key map.  Names are followed by a 32-byte hash when flag 0x0200 is
set.  A raw packet is u16 packet index, u64 ns since 1970, another u64 (flag 0x0040: time received),
u32 length and further data (0x0080), and the packet's bytes.  0x0800 marks commands.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

from stcal.errors import InputError

MAGIC = b"COSMOS5_"
_OLDER = (b"COSMOS4_", b"COSMOS2_")
_TARGET, _PACKET, _RAW, _OFFSET = 0x1000, 0x2000, 0x3000, 0x5000
_RECEIVED_TIME = 0x0040


def is_log(head: bytes, where: str) -> bool:
    """Whether a file that begins so is a log; ``where`` names it in the error.

    Raises
    ------
    InputError
        It is a log of COSMOS 4 or older, which has another form.
    """
    if head.startswith(_OLDER):
        version = head[6:7].decode("ascii")
        raise InputError(f"{where}: a COSMOS {version} log; convert it with OpenC3 COSMOS 5 first")
    return head.startswith(MAGIC)


def log_of(
    packets: Iterable[tuple[int, bytes]],
    target: str,
    packet: str,
    received_ns: int | None = None,
) -> bytes:
    """Return the log of telemetry packets, each with its time, ns since 1970 UTC.

    ``received_ns`` is added to each time as the time of reception, where given.
    """
    parts = [MAGIC, _entry(_TARGET, target.encode()), _entry(_PACKET, b"\0\0" + packet.encode())]
    for time_ns, content in packets:
        head = struct.pack(">HQ", 0, time_ns)
        if received_ns is not None:
            head += struct.pack(">Q", time_ns + received_ns)
        flags = _RAW | (_RECEIVED_TIME if received_ns is not None else 0)
        parts.append(_entry(flags, head + content))
    parts.append(_entry(_OFFSET, f"0-0,{target}__{packet}".encode()))
    return b"".join(parts)


def _entry(flags: int, data: bytes) -> bytes:
    return struct.pack(">IH", 2 + len(data), flags) + data
