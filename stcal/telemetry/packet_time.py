"""Time codes of packets (CCSDS 301.0-B): unsegmented (CUC) and day segmented (CDS).

``scale`` says in which time scale the epoch's label stands and what is counted:

- TAI, GPS: seconds that all have one length (GPS time is TAI - 19 s).  CUC with the CCSDS epoch,
  1958-01-01, is TAI.
- UTC with CDS: UTC days, whose last millisecond may be 86 400 999 where there is a leap second.
- UTC with CUC: POSIX seconds, 86 400 a day; a leap second has no number of its own.

Seconds since a UTC epoch in which leap seconds are counted are TAI from the epoch's TAI label on:
2000-01-01T12:00:00 UTC is ``epoch = "2000-01-01T12:00:32"``, ``scale = "TAI"``.
"""

from __future__ import annotations

import re
from datetime import datetime, timedelta
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, model_validator

from stcal.config import STRICT
from stcal.frames import Bools, Ints
from stcal.times import FIRST_UTC_NS, tai_from_utc_ns, utc_from_tai_ns

_NS = 1_000_000_000
_MS_NS = 1_000_000
_DAY_NS = 86_400 * _NS
GPS_MINUS_TAI_NS = -19 * _NS
_EPOCH = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}", re.ASCII)
# Beyond the year 2262 nanoseconds leave an int64.
_LATEST_NS = int(np.datetime64("2261-01-01", "ns").astype(np.int64))
_CUC_ONLY = ("coarse_bytes", "fine_bytes")
_CDS_ONLY = ("day_bytes", "submillisecond_bytes")
_CCSDS_EPOCH = "1958-01-01T00:00:00"

Raw = NDArray[np.uint64]


class TimeCode(BaseModel):
    """The time code of the secondary header; its bytes come from the most significant on."""

    model_config = STRICT

    code: Literal["CUC", "CDS"]
    epoch: str
    scale: Literal["TAI", "GPS", "UTC"]
    # Whether a preamble octet, which describes the code, stands in front of it in every packet.
    p_field: bool = False
    coarse_bytes: Annotated[int, Field(ge=1, le=7)] = 4
    fine_bytes: Annotated[int, Field(ge=0, le=6)] = 2
    day_bytes: Literal[2, 3] = 2
    submillisecond_bytes: Literal[0, 2, 4] = 0

    @model_validator(mode="after")
    def _whole(self) -> TimeCode:
        if not _EPOCH.fullmatch(self.epoch):
            raise ValueError(f"epoch {self.epoch!r} is not as 1958-01-01T00:00:00, in the scale")
        try:
            epoch = datetime.fromisoformat(self.epoch)
        except ValueError as error:
            raise ValueError(f"epoch {self.epoch!r}: {error}") from None
        if not datetime(1900, 1, 1) <= epoch < datetime(2200, 1, 1):
            raise ValueError(f"epoch {self.epoch!r} is not from 1900 to 2199")
        if self.code == "CUC" and self.scale == "UTC" and self.epoch_ns < 0:
            raise ValueError("CUC from the CCSDS epoch counts TAI; UTC needs an epoch from 1970")
        others = _CDS_ONLY if self.code == "CUC" else _CUC_ONLY
        wrong = [name for name in others if name in self.model_fields_set]
        if wrong:
            raise ValueError(f"{', '.join(wrong)}: not for code {self.code}")
        if self.code == "CDS" and not self.epoch.endswith("T00:00:00"):
            raise ValueError("the epoch of CDS is the beginning of a day")
        if self.p_field and (self.code == "CUC" and (self.coarse_bytes > 4 or self.fine_bytes > 3)):
            raise ValueError("a preamble of one octet has at most 4 coarse and 3 fine bytes")
        return self

    @property
    def widths(self) -> tuple[tuple[str, int], ...]:
        """Name and bytes of each part, in their order."""
        parts = [("p_field", int(self.p_field))]
        if self.code == "CUC":
            parts += [("coarse", self.coarse_bytes), ("fine", self.fine_bytes)]
        else:
            parts += [("day", self.day_bytes), ("millisecond", 4)]
            parts += [("submillisecond", self.submillisecond_bytes)]
        return tuple((name, size) for name, size in parts if size)

    @property
    def length(self) -> int:
        """Bytes of the whole code."""
        return sum(size for _, size in self.widths)

    @property
    def epoch_ns(self) -> int:
        """The epoch's label, ns since 1970 of its own scale."""
        since = datetime.fromisoformat(self.epoch) - datetime(1970, 1, 1)
        return (since // timedelta(seconds=1)) * _NS

    @property
    def preamble(self) -> int:
        """The preamble octet (301.0-B, 3.2.2 and 3.3.2)."""
        agency = self.epoch != _CCSDS_EPOCH
        if self.code == "CUC":
            return (1 + agency) << 4 | (self.coarse_bytes - 1) << 2 | self.fine_bytes
        submillisecond = {0: 0, 2: 1, 4: 2}[self.submillisecond_bytes]
        return 4 << 4 | agency << 3 | (self.day_bytes == 3) << 2 | submillisecond

    @property
    def resolution_ns(self) -> float:
        """The length of one count."""
        if self.code == "CUC":
            return float(_NS / 256**self.fine_bytes)
        return {0: 1e6, 2: 1e3, 4: 1e-3}[self.submillisecond_bytes]


def to_tai_ns(code: TimeCode, parts: dict[str, Raw]) -> tuple[Ints, Bools]:
    """Return TAI ns since 1970 of the raw parts of time codes, and which are no time (0 there)."""
    size = len(next(iter(parts.values())))
    bad = np.zeros(size, dtype=np.bool_)
    if code.p_field:
        bad |= parts["p_field"] != code.preamble
    if code.code == "CUC":
        whole, rest, beyond = _cuc(code, parts)
        return _in_scale(code, whole, rest, bad | beyond)
    return _cds(code, parts, bad)


def _cuc(code: TimeCode, parts: dict[str, Raw]) -> tuple[Ints, Ints, Bools]:
    """Return (ns of whole seconds, ns of the fraction, beyond any time)."""
    coarse = parts["coarse"]
    limit = (_LATEST_NS - code.epoch_ns) // _NS
    beyond = coarse > np.uint64(limit)
    whole = np.where(beyond, np.uint64(0), coarse).astype(np.int64) * _NS
    if code.fine_bytes == 0:
        return whole, np.zeros_like(whole), beyond
    # 32 bits of fraction are a quarter of a nanosecond.
    shift = 32 - 8 * code.fine_bytes
    fine = parts["fine"].astype(np.int64)
    fine = fine << shift if shift >= 0 else fine >> -shift
    return whole, (fine * _NS + (1 << 31)) >> 32, beyond


def _in_scale(code: TimeCode, whole: Ints, rest: Ints, bad: Bools) -> tuple[Ints, Bools]:
    label = code.epoch_ns + whole + rest
    if code.scale == "UTC":
        bad = bad | (label < FIRST_UTC_NS)
        return np.where(bad, 0, tai_from_utc_ns(np.maximum(label, FIRST_UTC_NS))), bad
    tai = label - GPS_MINUS_TAI_NS if code.scale == "GPS" else label
    bad = bad | (tai < _first_tai_ns())
    return np.where(bad, 0, tai), bad


def _first_tai_ns() -> int:
    return int(tai_from_utc_ns(np.array([FIRST_UTC_NS]))[0])


def _cds(code: TimeCode, parts: dict[str, Raw], bad: Bools) -> tuple[Ints, Bools]:
    limit = (_LATEST_NS - code.epoch_ns) // _DAY_NS
    beyond = parts["day"] > np.uint64(limit)
    day = np.where(beyond, np.uint64(0), parts["day"]).astype(np.int64) * _DAY_NS
    of_day = parts["millisecond"].astype(np.int64) * _MS_NS
    if code.submillisecond_bytes:
        unit, per_ms = (1000, 1000) if code.submillisecond_bytes == 2 else (1, 10**9)
        raw = parts["submillisecond"].astype(np.int64)
        bad = bad | (raw >= per_ms)
        of_day += raw * unit if unit == 1000 else (raw + 500) // 1000
    bad = bad | beyond
    if code.scale != "UTC":
        return _in_scale(code, day, of_day, bad | (of_day >= _DAY_NS))
    label = code.epoch_ns + day
    bad = bad | (label < FIRST_UTC_NS)
    start = tai_from_utc_ns(np.where(bad, FIRST_UTC_NS, label))
    length = tai_from_utc_ns(np.where(bad, FIRST_UTC_NS, label) + _DAY_NS) - start
    bad = bad | (parts["millisecond"].astype(np.int64) * _MS_NS >= length)
    return np.where(bad, 0, start + of_day), bad


def from_tai_ns(code: TimeCode, t_tai_ns: Ints) -> dict[str, Raw]:
    """Return the raw parts of times, to the code's resolution: CUC rounded, CDS cut.

    Raises
    ------
    ValueError
        A time that the code cannot say.
    """
    whole, rest = _since_epoch(code, np.asarray(t_tai_ns, dtype=np.int64))
    parts = _cuc_parts(code, whole, rest) if code.code == "CUC" else _cds_parts(code, whole, rest)
    if code.p_field:
        parts["p_field"] = np.full(len(whole), code.preamble)
    sizes = dict(code.widths)
    for name, values in parts.items():
        if np.any(values < 0) or np.any(values >= 256 ** sizes[name]):
            raise ValueError(f"a time lies outside what the {code.code} code's {name} can count")
    return {name: values.astype(np.uint64) for name, values in parts.items()}


def _since_epoch(code: TimeCode, tai: Ints) -> tuple[Ints, Ints]:
    """Return whole seconds (CUC) or days (CDS) since the epoch, and the ns of the rest."""
    unit = _NS if code.code == "CUC" else _DAY_NS
    if code.scale != "UTC":
        label = tai + GPS_MINUS_TAI_NS if code.scale == "GPS" else tai
        whole, rest = np.divmod(label - code.epoch_ns, unit)
        return whole, rest
    utc = utc_from_tai_ns(tai)
    if code.code == "CUC":
        whole, rest = np.divmod(utc - code.epoch_ns, unit)
        return whole, rest
    day = (utc - code.epoch_ns) // _DAY_NS
    # From the day's beginning in TAI, so that a leap second goes beyond 86 400 000 ms.
    return day, tai - tai_from_utc_ns(code.epoch_ns + day * _DAY_NS)


def _cuc_parts(code: TimeCode, whole: Ints, rest: Ints) -> dict[str, Ints]:
    if code.fine_bytes == 0:
        return {"coarse": whole + (rest >= _NS // 2)}
    steps = 256**code.fine_bytes
    # In two halves: 2^48 * 1e9 leaves an int64.
    high, low = np.divmod(rest * min(steps, 2**32), _NS)
    extra = max(steps // 2**32, 1)
    fine = high * extra + (low * extra * 2 + _NS) // (2 * _NS)
    return {"coarse": whole + fine // steps, "fine": fine % steps}


def _cds_parts(code: TimeCode, day: Ints, rest: Ints) -> dict[str, Ints]:
    if code.submillisecond_bytes == 0:
        return {"day": day, "millisecond": rest // _MS_NS}
    # Cut off, not rounded: a day's last millisecond must not round into a millisecond it lacks.
    millisecond, nano = np.divmod(rest, _MS_NS)
    counts = nano // 1000 if code.submillisecond_bytes == 2 else nano * 1000
    return {"day": day, "millisecond": millisecond, "submillisecond": counts}
