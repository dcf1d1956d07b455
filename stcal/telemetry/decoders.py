"""The telemetry formats by name, and which of them a file is in."""

from __future__ import annotations

import re

from stcal.errors import InputError
from stcal.telemetry import csv, jsonl
from stcal.telemetry.block import Decoder
from stcal.telemetry.sources import SourceFile

DECODERS = {decoder.name: decoder for decoder in (csv.DECODER, jsonl.DECODER)}
# A first line that is only garbage, such as [1, 2], must not cost the file.
_ARRAY = re.compile(rb"(\xef\xbb\xbf)?\s*\[\s*(\{|\]?\s*$)")


def choose(source: SourceFile) -> Decoder:
    """Return the decoder of a file: by its first bytes, else by the ending of its name.

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
    known = ", ".join(DECODERS)
    raise InputError(f"{source.path}: not telemetry in any known format ({known})")
