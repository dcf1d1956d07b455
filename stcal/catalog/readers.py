"""Readers of the official files: Tycho-2 and its supplement 1 (CDS I/259), Hipparcos-2 (I/311).

Columns get the package's names and units at this door; positions come out as the files give them,
with their epochs, and are moved to J2000.0 by :mod:`stcal.catalog.build`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stcal.catalog.fixed_width import Records, read_records
from stcal.catalog.identifiers import tycho_code
from stcal.catalog.photometry import johnson_from_hipparcos, johnson_from_tycho
from stcal.catalog.sphere import motion_vector, unit_vector
from stcal.constants import DEG, MAS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

TYCHO2_LENGTH, SUPPLEMENT_LENGTH, HIPPARCOS_LENGTH = 206, 122, 276
SATELLITE_EPOCH = 1991.25

# Bytes that separate fields in the two Tycho-2 files (checked: a shifted row cannot pass).
_TYCHO2_BARS = (
    *(13, 15, 28, 41, 49, 57, 61, 65, 70, 75, 83, 91, 94, 98, 102, 106),
    *(110, 117, 123, 130, 136, 140, 142, 152, 165, 178, 183, 188, 194, 200, 202),
)
_SUPPLEMENT_BARS = (13, 15, 28, 41, 49, 57, 63, 69, 75, 81, 83, 90, 96, 103, 109, 113, 115)
_BRIGHTEST, _FAINTEST = -2.0, 25.0
_FASTEST_MAS_YR = 11_000.0
_MAXIMUM_HIP = 120_404


@dataclass(frozen=True)
class SourceStars:
    """Stars as one official file gives them, N rows.

    Attributes
    ----------
    tycho_id : (N,) code of the Tycho number, 0 where the file has none
    hip : (N,) Hipparcos number, 0 where the file has none
    direction : (N, 3) ICRS unit vector at ``epoch``
    epoch : (N,) Julian year of the position
    motion : (N, 3) rad per Julian year, zero where unknown
    has_motion : (N,) whether the file gives a proper motion
    parallax : (N,) rad, NaN where the file has none
    magnitude, colour : (N,) Johnson V and B-V, NaN where unknown
    multiple : (N,) flagged as double, as a component, or as a photocentre
    merged : (N,) whether the position is the photocentre of two entries
    """

    tycho_id: Ints
    hip: Ints
    direction: Floats
    epoch: Floats
    motion: Floats
    has_motion: Bools
    parallax: Floats
    magnitude: Floats
    colour: Floats
    multiple: Bools
    merged: Bools

    def take(self, rows: Bools | Ints) -> SourceStars:
        """Return the selected rows (mask, or indices in the wanted order)."""
        return SourceStars(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def join(parts: list[SourceStars]) -> SourceStars:
    """Return the rows of all parts, in their order."""
    names = [f.name for f in fields(SourceStars)]
    return SourceStars(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})


def read_tycho2(path: Path, faintest: float = np.inf) -> SourceStars:
    """Read ``tyc2.dat`` or one of its parts (``tyc2.dat.00.gz``; ``catalog.dat`` on the CD).

    Rows fainter than ``faintest`` [V], or without a magnitude, are left out.  A row without mean
    position (flag X) has the satellite's position, at its own epoch, and no proper motion.

    Raises
    ------
    InputError
        Naming file, row and field.
    """
    return join([_bright(_tycho2(part), faintest) for part in read_records(path, TYCHO2_LENGTH)])


def read_supplement(path: Path, faintest: float = np.inf) -> SourceStars:
    """Read ``suppl_1.dat``, whose positions are at J1991.25.

    Rows fainter than ``faintest`` [V], or without a magnitude, are left out.

    Raises
    ------
    InputError
        Naming file, row and field.
    """
    parts = read_records(path, SUPPLEMENT_LENGTH)
    return join([_bright(_supplement(part), faintest) for part in parts])


def read_hipparcos(path: Path) -> SourceStars:
    """Read ``hip2.dat``, whose positions are at J1991.25.

    Raises
    ------
    InputError
        Naming file, row and field.
    """
    return join([_hipparcos(part) for part in read_records(path, HIPPARCOS_LENGTH)])


def _bright(stars: SourceStars, faintest: float) -> SourceStars:
    # Written so that a missing magnitude (NaN) drops out too.
    return stars.take(stars.magnitude <= faintest)


def _check_bars(records: Records, bars: tuple[int, ...]) -> None:
    for byte in bars:
        records.require(records.letters(byte) == "|", f"no '|' at byte {byte}")


def _tycho_id(records: Records) -> Ints:
    tyc1 = records.ints("TYC1", 1, 4, 1, 9537)
    tyc2 = records.ints("TYC2", 6, 10, 1, 12121)
    return tycho_code(tyc1, tyc2, records.ints("TYC3", 12, 12, 1, 4))


def _check_letters(records: Records, name: str, byte: int, allowed: str) -> NDArray[np.str_]:
    letters = records.letters(byte)
    reason = f"{name} (byte {byte}) is not one of {', '.join(map(repr, allowed))}"
    records.require(np.isin(letters, list(allowed)), reason)
    return letters


def _place(ra_deg: Floats, dec_deg: Floats, east: Floats, north: Floats) -> tuple[Floats, Floats]:
    """Return direction and motion; east and north in mas per year, NaN where unknown."""
    ra, dec = ra_deg * DEG, dec_deg * DEG
    motion = motion_vector(ra, dec, np.nan_to_num(east) * MAS, np.nan_to_num(north) * MAS)
    return unit_vector(ra, dec), motion


def _motions(records: Records, bytes_east: tuple[int, int]) -> tuple[Floats, Floats]:
    first, last = bytes_east
    limits = (-_FASTEST_MAS_YR, _FASTEST_MAS_YR, True)
    east = records.floats("pmRA", first, last, *limits)
    return east, records.floats("pmDE", first + 8, last + 8, *limits)


def _tycho2(records: Records) -> SourceStars:
    _check_bars(records, _TYCHO2_BARS)
    flag = _check_letters(records, "pflag", 14, " PX")
    double = _check_letters(records, "posflg", 201, " DP")
    seen_ra = records.floats("RAdeg", 153, 164, 0.0, 360.0)
    seen_dec = records.floats("DEdeg", 166, 177, -90.0, 90.0)
    mean_ra = records.floats("RAmdeg", 16, 27, 0.0, 360.0, True)
    mean_dec = records.floats("DEmdeg", 29, 40, -90.0, 90.0, True)
    has_mean = np.isfinite(mean_ra) & np.isfinite(mean_dec)
    records.require(has_mean == (flag != "X"), "pflag and mean position (bytes 14-40) disagree")
    seen_epoch = 1990.0 + 0.5 * (
        records.floats("EpRA-1990", 179, 182, 0.0, 4.0)
        + records.floats("EpDE-1990", 184, 187, 0.0, 4.0)
    )
    east, north = _motions(records, (42, 48))
    direction, motion = _place(
        np.where(has_mean, mean_ra, seen_ra), np.where(has_mean, mean_dec, seen_dec), east, north
    )
    bt = records.floats("BTmag", 111, 116, _BRIGHTEST, _FAINTEST, True)
    vt = records.floats("VTmag", 124, 129, _BRIGHTEST, _FAINTEST, True)
    magnitude, colour = johnson_from_tycho(bt, vt)
    merged = (flag == "P") | (double == "P")
    return SourceStars(
        tycho_id=_tycho_id(records),
        hip=records.ints("HIP", 143, 148, 1, _MAXIMUM_HIP, True),
        direction=direction,
        epoch=np.where(has_mean, 2000.0, seen_epoch),
        motion=motion,
        has_motion=np.isfinite(east) & np.isfinite(north),
        parallax=np.full(len(bt), np.nan),
        magnitude=magnitude,
        colour=colour,
        multiple=merged | (double == "D") | ~records.blank(149, 151),
        merged=merged,
    )


def _supplement(records: Records) -> SourceStars:
    _check_bars(records, _SUPPLEMENT_BARS)
    _check_letters(records, "flag", 14, "HT")
    kind = _check_letters(records, "mflag", 82, " BVH")
    ra = records.floats("RAdeg", 16, 27, 0.0, 360.0)
    dec = records.floats("DEdeg", 29, 40, -90.0, 90.0)
    east, north = _motions(records, (42, 48))
    direction, motion = _place(ra, dec, east, north)
    bt = records.floats("BTmag", 84, 89, _BRIGHTEST, _FAINTEST, True)
    vt = records.floats("VTmag", 97, 102, _BRIGHTEST, _FAINTEST, True)
    # mflag H: the field of VT holds Hp.
    unknown = np.full(len(bt), np.nan)
    magnitude, colour = johnson_from_tycho(bt, np.where(kind == "H", np.nan, vt))
    from_hp = johnson_from_hipparcos(vt, unknown)
    return SourceStars(
        tycho_id=_tycho_id(records),
        hip=records.ints("HIP", 116, 121, 1, _MAXIMUM_HIP, True),
        direction=direction,
        epoch=np.full(len(bt), SATELLITE_EPOCH),
        motion=motion,
        has_motion=np.isfinite(east) & np.isfinite(north),
        parallax=unknown,
        magnitude=np.where(kind == "H", from_hp, magnitude),
        colour=np.where(kind == "H", np.nan, colour),
        multiple=~records.blank(122, 122),
        merged=np.zeros(len(bt), dtype=np.bool_),
    )


def _hipparcos(records: Records) -> SourceStars:
    ra = records.floats("RArad", 16, 28, 0.0, 6.2832) / DEG
    dec = records.floats("DErad", 30, 42, -1.5708, 1.5708) / DEG
    east = records.floats("pmRA", 52, 59, -_FASTEST_MAS_YR, _FASTEST_MAS_YR)
    north = records.floats("pmDE", 61, 68, -_FASTEST_MAS_YR, _FASTEST_MAS_YR)
    direction, motion = _place(ra, dec, east, north)
    hp = records.floats("Hpmag", 130, 136, _BRIGHTEST, _FAINTEST)
    colour = records.floats("B-V", 153, 158, -2.0, 9.0, True)
    # The file writes an unknown colour as 0.000 with a standard error of 0.000.
    known = (colour != 0.0) | (records.floats("e_B-V", 160, 164, 0.0, 99.0, True) > 0.0)
    colour = np.where(known, colour, np.nan)
    components = records.ints("Nc", 14, 14, 0, 9)
    size = len(hp)
    return SourceStars(
        tycho_id=np.zeros(size, dtype=np.int64),
        hip=records.ints("HIP", 1, 6, 1, _MAXIMUM_HIP),
        direction=direction,
        epoch=np.full(size, SATELLITE_EPOCH),
        motion=motion,
        has_motion=np.ones(size, dtype=np.bool_),
        parallax=records.floats("Plx", 44, 50, -2000.0, 2000.0) * MAS,
        magnitude=johnson_from_hipparcos(hp, colour),
        colour=colour,
        multiple=components > 1,
        merged=np.zeros(size, dtype=np.bool_),
    )
