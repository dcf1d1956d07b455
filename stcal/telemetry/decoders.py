"""The telemetry formats by name, and which of them a file is in."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING

from stcal.errors import InputError
from stcal.telemetry import csv, jsonl
from stcal.telemetry.block import Again, Decoder
from stcal.telemetry.sources import SourceFile

if TYPE_CHECKING:
    from stcal.telemetry.mapping import SourceMapping
    from stcal.telemetry.packet_layout import PacketLayout

DECODERS = {decoder.name: decoder for decoder in (csv.DECODER, jsonl.DECODER)}


def _text_again(context: bytes) -> Again:
    from stcal.telemetry.mapped_text import decode_again

    return decode_again(context)


def _arrow_again(context: bytes) -> Again:
    from stcal.telemetry.mapped_arrow import decode_again

    return decode_again(context)


def _packets_again(layout: bytes) -> Again:
    from stcal.telemetry.packets import decode_again

    return decode_again(layout)


# How refused records are decoded again, by the format and what it kept as its context.
AGAIN: dict[str, Callable[[bytes], Again]] = {
    "csv": lambda header: Again(csv.decode, prefix=header, separator=b"\n"),
    # The blank first line keeps a byte-order mark where it was: within a line.
    "jsonl": lambda _: Again(jsonl.decode, separator=b"\n"),
    "mapped-text": _text_again,
    "mapped-arrow": _arrow_again,
    "ccsds": _packets_again,
    "cosmos": _packets_again,
}
# A first line that is only garbage, such as [1, 2], must not cost the file.
_ARRAY = re.compile(rb"(\xef\xbb\xbf)?\s*\[\s*(\{|\]?\s*$)")


def of_mapping(mapping: SourceMapping) -> Decoder:
    """Return the decoder of a foreign table with a column mapping."""
    from stcal.telemetry import mapped_arrow, mapped_text

    if mapping.is_text:
        return mapped_text.make_decoder(mapping)
    return mapped_arrow.make_decoder(mapping)


def choose(source: SourceFile, packets: PacketLayout | None = None) -> Decoder:
    """Return the decoder of a file: by its first bytes, else by the ending of its name.

    With the layout of packets, what is not text is packets.

    Raises
    ------
    InputError
        Naming the file when neither tells, or when it is one JSON array of frames.
    """
    if _ARRAY.match(source.head):
        raise InputError(f"{source.path}: a JSON array, not JSON Lines (one frame a line)")
    for decoder in DECODERS.values():
        if decoder.sniff(source.head):
            return decoder
    name = source.path.name.removesuffix(".gz")
    for decoder in DECODERS.values():
        if name.endswith(decoder.extensions):
            return decoder
    if packets is not None:
        from stcal.telemetry.packets import make_decoder

        return make_decoder(packets, source)
    known = ", ".join(DECODERS)
    raise InputError(f"{source.path}: not telemetry in any known format ({known})")
