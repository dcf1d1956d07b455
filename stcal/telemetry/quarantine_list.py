"""What is in quarantine, counted and shown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from stcal.errors import InputError
from stcal.telemetry import quarantine
from stcal.telemetry.decoders import AGAIN
from stcal.telemetry.places import Place
from stcal.telemetry.summary import by_reason

_HEX_BYTES = 16


@dataclass(frozen=True)
class Selection:
    """Which records are meant; None means any.

    Attributes
    ----------
    source : a file's name, or the beginning of its hash (six characters at least)
    """

    source: str | None = None
    sensor: str | None = None
    frame: str | None = None
    code: str | None = None

    def mask(self, table: pa.Table) -> Any:
        """Return which records of one file are meant, an Arrow array of booleans."""
        mask = pa.array([True] * table.num_rows, pa.bool_())
        wanted = {"sensor_id": self.sensor, "frame_id": self.frame, "code": self.code}
        for name, value in wanted.items():
            if value is not None:
                mask = pc.and_(mask, pc.equal(table[name].combine_chunks(), value))
        if self.source is not None:
            # A file of displaced versions holds those of several sources.
            is_named = pc.equal(table["source"].combine_chunks(), self.source)
            if len(self.source) >= quarantine.SHORTEST_HASH:
                sha256 = table["source_sha256"].combine_chunks()
                is_named = pc.or_(is_named, pc.starts_with(sha256, self.source.lower()))
            mask = pc.and_(mask, is_named)
        return mask.fill_null(False)


@dataclass
class Listing:
    """Telemetry rows in quarantine by reason, by source and reason, by sensor and reason."""

    records: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    sources: dict[tuple[str, str], Counter[str]] = field(default_factory=dict)
    sensors: dict[str, Counter[str]] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """Return the counts as a JSON document."""
        return {
            "records": self.records,
            "rows": sum(self.reasons.values()),
            "by_reason": by_reason(self.reasons),
            "by_source": [
                {"source": name, "sha256": sha256, "rows": by_reason(counts)}
                for (name, sha256), counts in sorted(self.sources.items())
            ],
            "by_sensor": {name: by_reason(counts) for name, counts in sorted(self.sensors.items())},
        }


def listing(store: Place, selection: Selection) -> Listing:
    """Count the records selected; one file is in memory at a time."""
    found = Listing()
    for _, table in _tables(store, selection):
        found.records += table.num_rows
        keys = ["code", "source", "source_sha256", "sensor_id"]
        for row in table.group_by(keys).aggregate([("rows", "sum")]).to_pylist():
            code, rows = row["code"], row["rows_sum"]
            source = row["source"], row["source_sha256"]
            found.reasons[code] += rows
            found.sources.setdefault(source, Counter())[code] += rows
            found.sensors.setdefault(row["sensor_id"], Counter())[code] += rows
    return found


def shown(store: Place, selection: Selection, limit: int) -> Iterator[dict[str, Any]]:
    """Yield up to ``limit`` records selected, each with its bytes as text or in hex.

    ``text`` is None where the bytes are no text and their format cannot say what they are.
    """
    for path, table in _tables(store, selection):
        origin = quarantine.origin_of(table, path)
        show = None
        if origin is not None and origin.format in AGAIN:
            show = AGAIN[origin.format](origin.context).show
        for record in table.slice(0, limit).to_pylist():
            raw = record.pop("raw")
            yield {**record, "text": _text(raw, show), "hex": raw.hex()}
        limit -= min(limit, table.num_rows)
        if not limit:
            return


def _text(raw: bytes, show: Any) -> str | None:
    try:
        text = raw.decode("utf-8") if show is None else show(raw)
    except (UnicodeDecodeError, InputError):
        return None
    return str(text) if all(c.isprintable() or c == "\t" for c in text) else None


def hex_dump(raw: bytes, offset: int) -> Iterator[str]:
    """Yield the lines of a hex dump whose first byte is at ``offset``; 0 where it is unknown."""
    first = max(offset, 0)
    for start in range(0, len(raw), _HEX_BYTES):
        part = raw[start : start + _HEX_BYTES]
        letters = "".join(chr(b) if 32 <= b < 127 else "." for b in part)
        yield f"{first + start:08x}  {part.hex(' '):<{3 * _HEX_BYTES - 1}}  {letters}"


def _tables(store: Place, selection: Selection) -> Iterator[tuple[Place, pa.Table]]:
    for path in quarantine.paths(store):
        table = quarantine.read_file(path)
        selected = table.filter(selection.mask(table))
        if selected.num_rows:
            yield path, selected
