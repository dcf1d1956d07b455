"""Decoder of a cFE table image, as table services read it; shares no code with the encoder."""

from __future__ import annotations

from dataclasses import dataclass

from stcal.uplink.decode import DecodeError

MAGIC = b"cFE1"
_FIRST, _SECOND = 64, 52
_WORDS = ("content type", "subtype", "length", "spacecraft", "processor", "application",
          "seconds", "subseconds")  # fmt: skip
_TABLE_WORDS = ("reserved", "offset", "bytes")


@dataclass(frozen=True)
class TableImage:
    """Both headers by the names of their fields, and the structure."""

    header: dict[str, int | str]
    payload: bytes


def read_image(content: bytes) -> TableImage:
    """Split a table image.

    Raises
    ------
    DecodeError
        When the headers are not those of a whole table, or the size is another than they say.
    """
    if len(content) < _FIRST + _SECOND:
        raise DecodeError(f"a cFE table image has 116 bytes of headers, here are {len(content)}")
    if content[:4] != MAGIC:
        raise DecodeError(f"cFE header: content type is {content[:4].hex()}, not {MAGIC.hex()}")
    header: dict[str, int | str] = {}
    for k, name in enumerate(_WORDS):
        header[name] = int.from_bytes(content[4 * k : 4 * k + 4], "big")
    header["description"] = _text("description", content[32:64])
    for k, name in enumerate(_TABLE_WORDS):
        header[name] = int.from_bytes(content[64 + 4 * k : 68 + 4 * k], "big")
    header["table name"] = _text("table name", content[76:116])
    payload = content[116:]
    for name, expected in (("subtype", 8), ("length", 64), ("reserved", 0), ("offset", 0),
                           ("bytes", len(payload))):  # fmt: skip
        if header[name] != expected:
            raise DecodeError(f"cFE header: {name} is {header[name]}, not {expected}")
    return TableImage(header, payload)


def _text(name: str, field: bytes) -> str:
    """Return a text that ends with the first NUL and has nothing but NUL after it."""
    text, _, rest = field.partition(b"\0")
    if text == field or rest.strip(b"\0"):
        raise DecodeError(f"cFE header: {name} {field!r} does not end in NUL")
    try:
        return text.decode("ascii")
    except UnicodeDecodeError:
        raise DecodeError(f"cFE header: {name} {field!r} is not ASCII") from None
