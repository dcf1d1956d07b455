"""Compiled parts of packet decoding: CRC, lengths, and the unpacking of bit fields."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stcal.catalog.identifiers import HIP_LIMIT, MALFORMED, TYCHO_BASE
from stcal.frames import Ints
from stcal.jit import kernel

NOT_OURS, OURS, IGNORED = 0, 1, 2
FITS, TOO_SHORT_OR_LONG, TOO_MANY = 0, 1, 2


class Program(NamedTuple):
    """A layout as kernels read it.

    Attributes
    ----------
    kind : (2048,) of each APID: not ours, ours, ignored
    smallest, largest : bytes of a packet of ours
    crc_bytes : 2 or 0
    segment_bits : (L + 1,) bits before, between and behind the lists
    stride, maximum : (L,) bits of an entry, most entries
    full : (L,) whether all entries are always there
    count_segment, count_bit, count_width, count_little : (L,) where the count stands
    """

    kind: Ints
    smallest: int
    largest: int
    crc_bytes: int
    segment_bits: Ints
    stride: Ints
    maximum: Ints
    full: Ints
    count_segment: Ints
    count_bit: Ints
    count_width: Ints
    count_little: Ints


def _crc_tables() -> Ints:
    """Return (4, 256): the CRC of a byte that 0 to 3 zero bytes follow."""
    tables = np.zeros((4, 256), np.int64)
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        tables[0, byte] = crc & 0xFFFF
    for k in range(1, 4):
        before = tables[k - 1]
        tables[k] = ((before << 8) & 0xFFFF) ^ tables[0][before >> 8]
    return tables


_CRC = _crc_tables()


@kernel
def crc16(data, start, stop):
    """CRC-16 of ``data[start:stop]``: polynomial 0x1021, first 0xFFFF, nothing reflected.

    Over a packet with its own CRC at the end it is 0.
    """
    crc = 0xFFFF
    i = start
    while i + 4 <= stop:
        crc = (
            _CRC[3, (crc >> 8) ^ np.int64(data[i])]
            ^ _CRC[2, (crc & 0xFF) ^ np.int64(data[i + 1])]
            ^ _CRC[1, np.int64(data[i + 2])]
            ^ _CRC[0, np.int64(data[i + 3])]
        )
        i += 4
    while i < stop:
        crc = ((crc << 8) & 0xFFFF) ^ _CRC[0, (crc >> 8) ^ np.int64(data[i])]
        i += 1
    return crc


@kernel
def _word(data, byte):
    """Eight bytes as one number: written out, this is a single load."""
    return (
        np.uint64(data[byte]) << np.uint64(56)
        | np.uint64(data[byte + 1]) << np.uint64(48)
        | np.uint64(data[byte + 2]) << np.uint64(40)
        | np.uint64(data[byte + 3]) << np.uint64(32)
        | np.uint64(data[byte + 4]) << np.uint64(24)
        | np.uint64(data[byte + 5]) << np.uint64(16)
        | np.uint64(data[byte + 6]) << np.uint64(8)
        | np.uint64(data[byte + 7])
    )


@kernel
def _bits(data, bit, width):
    """The ``width`` bits from ``bit`` on as a number; the most significant comes first."""
    byte = bit >> 3
    if (bit & 7) + width <= 64 and byte + 8 <= len(data):
        return _word(data, byte) << np.uint64(bit & 7) >> np.uint64(64 - width)
    have = 8 - (bit & 7)
    value = np.uint64(data[byte]) & np.uint64((1 << have) - 1)
    while have < width:
        left = width - have
        byte += 1
        if left >= 8:
            value = (value << np.uint64(8)) | np.uint64(data[byte])
            have += 8
        else:
            value = (value << np.uint64(left)) | (np.uint64(data[byte]) >> np.uint64(8 - left))
            have = width
    return value >> np.uint64(have - width)


@kernel
def _reversed(value, width):
    """The bytes of a number in reverse order."""
    turned = np.uint64(0)
    for _ in range(width >> 3):
        turned = (turned << np.uint64(8)) | (value & np.uint64(0xFF))
        value >>= np.uint64(8)
    return turned


@kernel
def find_segments(data, start, total, program, segment, count):
    """Find the segments (bit each begins at) and list lengths of a packet; return FITS or why not.

    ``total`` are the packet's bytes as its header says.
    """
    first = 8 * start
    last = first + 8 * (total - program.crc_bytes)
    segment[0] = first
    for k in range(len(program.stride)):
        place = segment[program.count_segment[k]] + program.count_bit[k]
        if place + program.count_width[k] > last:
            return TOO_SHORT_OR_LONG
        found = _bits(data, place, program.count_width[k])
        if program.count_little[k]:
            found = _reversed(found, program.count_width[k])
        count[k] = np.int64(found)
        if count[k] > program.maximum[k]:
            return TOO_MANY
        there = program.maximum[k] if program.full[k] else count[k]
        segment[k + 1] = segment[k] + program.segment_bits[k] + there * program.stride[k]
        if segment[k + 1] > last:
            return TOO_SHORT_OR_LONG
    bits = segment[len(program.stride)] + program.segment_bits[-1] - first
    return FITS if (bits + 7) >> 3 == total - program.crc_bytes else TOO_SHORT_OR_LONG


@kernel
def measure(data, start, total, program, segment, count, fits):
    """Find the places of packets: segment (n, L + 1) bits, count (n, L), fits (n,)."""
    for i in range(len(start)):
        fits[i] = find_segments(data, start[i], total[i], program, segment[i], count[i])


@kernel
def unpack(data, start, count, stride, width, little, out):
    """Unpack one field of many lists into ``out`` (sum of count,) uint64, list after list.

    ``start`` (n,) is the bit of the field's first instance in each list, ``stride`` the bits from
    one to the next.
    """
    k = 0
    for i in range(len(start)):
        bit = start[i]
        for _ in range(count[i]):
            value = _bits(data, bit, width)
            out[k] = _reversed(value, width) if little else value
            bit += stride
            k += 1


@kernel
def pack(data, start, count, stride, width, little, values):
    """Write one field of many lists; the opposite of :func:`unpack`, into bytes that are 0."""
    k = 0
    for i in range(len(start)):
        bit = start[i]
        for _ in range(count[i]):
            value = _reversed(values[k], width) if little else values[k]
            for b in range(width):
                place = bit + b
                one = (value >> np.uint64(width - 1 - b)) & np.uint64(1)
                data[place >> 3] |= np.uint8(one << np.uint64(7 - (place & 7)))
            bit += stride
            k += 1


@kernel
def star_codes(raw, with_tycho, out):
    """Identifier codes of raw numbers as packet_stars.py describes them."""
    for i in range(len(raw)):
        number = np.int64(raw[i])
        out[i] = number if 0 <= number <= HIP_LIMIT else MALFORMED
        if with_tycho and number >> 31 == 1:
            tyc1, tyc2, tyc3 = number >> 17 & 0x3FFF, number >> 3 & 0x3FFF, number & 7
            if 1 <= tyc1 <= 9999 and tyc2 >= 1 and 1 <= tyc3 <= 3:
                out[i] = TYCHO_BASE + (tyc1 * 100_000 + tyc2) * 10 + tyc3


@kernel
def digest(data, start, total, out):
    """A 64-bit digest (FNV-1a by eight bytes) of each packet: equal ones are copies."""
    for i in range(len(start)):
        value = np.uint64(14695981039346656037)
        word = np.uint64(0)
        for j in range(total[i]):
            word = (word << np.uint64(8)) | np.uint64(data[start[i] + j])
            if j & 7 == 7 or j == total[i] - 1:
                value = (value ^ word) * np.uint64(1099511628211)
                value ^= value >> np.uint64(29)
                word = np.uint64(0)
        out[i] = value
