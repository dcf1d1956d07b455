"""What an ingest did, counted: per source and in total."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from stcal.telemetry.quarantine import REASONS

EXIT_DONE, EXIT_BAD_INPUT, EXIT_TOO_MUCH_QUARANTINED = 0, 3, 5


@dataclass
class Counts:
    """Telemetry rows and frames; a star of a JSON Lines file counts as a row.

    ``rows = stored_rows + duplicate_rows + quarantined_rows``.  Of the frames that could be read,
    ``frames = new_frames + replaced_frames + duplicate_frames + conflicting_frames``: replaced
    ones took the place of another version in the store, conflicting ones lost and are in
    quarantine.  ``stars`` are those of the new and the replaced frames.
    """

    rows: int = 0
    stored_rows: int = 0
    duplicate_rows: int = 0
    quarantined_rows: int = 0
    frames: int = 0
    new_frames: int = 0
    replaced_frames: int = 0
    duplicate_frames: int = 0
    conflicting_frames: int = 0
    stars: int = 0

    def __iadd__(self, other: Counts) -> Counts:
        """Add the counts of another source."""
        for entry in fields(Counts):
            name = entry.name
            setattr(self, name, getattr(self, name) + getattr(other, name))
        return self


@dataclass
class SourceSummary:
    """What became of one source.

    Attributes
    ----------
    quarantined : rows by the code of the reason
    error : why the file could not be used, or not whole; None when nothing is wrong with it
    packets : of a file of packets, their numbers by APID; None of other files
    """

    path: Path
    sha256: str | None = None
    format: str | None = None
    counts: Counts = field(default_factory=Counts)
    quarantined: Counter[str] = field(default_factory=Counter)
    sensors: set[str] = field(default_factory=set)
    warnings: list[str] = field(default_factory=list)
    error: str | None = None
    packets: dict[str, Any] | None = None

    def document(self) -> dict[str, Any]:
        """Return the summary as a JSON document."""
        return {
            "source": str(self.path),
            "sha256": self.sha256,
            "format": self.format,
            **vars(self.counts),
            "quarantined": by_reason(self.quarantined),
            "sensors": sorted(self.sensors),
            "packets": self.packets,
            "warnings": self.warnings,
            "error": self.error,
        }


@dataclass(frozen=True)
class IngestSummary:
    """What an ingest did; ``maximum_quarantine_share`` is the smallest of the configurations."""

    sources: tuple[SourceSummary, ...]
    maximum_quarantine_share: float

    @property
    def counts(self) -> Counts:
        """The counts of all sources."""
        total = Counts()
        for source in self.sources:
            total += source.counts
        return total

    @property
    def quarantined(self) -> dict[str, int]:
        """Rows in quarantine by reason."""
        return by_reason(sum((source.quarantined for source in self.sources), Counter()))

    @property
    def quarantine_share(self) -> float:
        """Share of the rows that went to quarantine."""
        counts = self.counts
        return counts.quarantined_rows / counts.rows if counts.rows else 0.0

    @property
    def errors(self) -> list[str]:
        """Why sources could not be used, or not whole."""
        return [source.error for source in self.sources if source.error is not None]

    @property
    def exit_code(self) -> int:
        """0 done, 3 a source is not usable or damaged, 5 too much was quarantined."""
        if self.errors:
            return EXIT_BAD_INPUT
        if self.quarantine_share > self.maximum_quarantine_share:
            return EXIT_TOO_MUCH_QUARANTINED
        return EXIT_DONE

    def document(self) -> dict[str, Any]:
        """Return the summary as a JSON document."""
        return {
            **vars(self.counts),
            "quarantined": self.quarantined,
            "quarantine_share": self.quarantine_share,
            "maximum_quarantine_share": self.maximum_quarantine_share,
            "sources": [source.document() for source in self.sources],
            "errors": self.errors,
            "exit_code": self.exit_code,
        }


def by_reason(counts: Counter[str]) -> dict[str, int]:
    """Return the counts in the order of the table of reasons."""
    return {code: counts[code] for code in REASONS if counts[code]}


def unique(texts: Iterable[str], limit: int = 20) -> list[str]:
    """Return the distinct texts in their order, at most ``limit`` of them."""
    distinct = list(dict.fromkeys(texts))
    more = len(distinct) - limit
    return distinct if more <= 0 else [*distinct[:limit], f"and {more} more"]
