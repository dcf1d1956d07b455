"""Making a catalogue of the official files of Tycho-2 and Hipparcos-2.

Positions go to J2000.0.  Hipparcos-2 astrometry is taken where its number belongs to one Tycho-2
star within an arcsecond; where Tycho-2 resolves a number into several stars, theirs is kept, as
the Hipparcos entry then stands for one of them or for their photocentre.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from stcal.catalog import merging, readers
from stcal.catalog.catalogue import StarCatalogue
from stcal.catalog.fixed_width import count_records
from stcal.catalog.readers import SourceStars
from stcal.catalog.sphere import propagate
from stcal.constants import ARCSEC
from stcal.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Letters = NDArray[np.str_]

SOURCES = {
    "H": "Hipparcos-2 astrometry, moved from J1991.25 to J2000.0",
    "T": "Tycho-2 main catalogue, mean position at J2000.0",
    "X": "Tycho-2 main catalogue, satellite position of about J1991.5, no proper motion",
    "S": "Tycho-2 supplement 1, moved from J1991.25 to J2000.0",
    "h": "Hipparcos-2 only; magnitude from Hp",
}
SAME_STAR_RAD = 1.0 * ARCSEC
# Tycho-2 is read this much deeper than the limit, so that a Hipparcos star near the limit is not
# taken for one that Tycho-2 lacks.
_MARGIN_MAG = 1.0
# Records of the whole files at the CDS: their name, length and number.
_OFFICIAL = {
    "tycho2": ("Tycho-2 main catalogue", readers.TYCHO2_LENGTH, 2_539_913),
    "supplement": ("Tycho-2 supplement 1", readers.SUPPLEMENT_LENGTH, 17_588),
    "hipparcos": ("Hipparcos-2", readers.HIPPARCOS_LENGTH, 117_955),
}


def build_catalogue(
    tycho2: Sequence[Path],
    supplement: Path | None,
    hipparcos: Path | None,
    limiting_magnitude: float,
) -> StarCatalogue:
    """Read the files and return their stars to ``limiting_magnitude`` [V], brightest first.

    ``tycho2`` may be the whole file or its parts.  ``warnings`` of the provenance names every file
    whose number of records is not the official one: a cut at the end of a row shows only there.

    Raises
    ------
    InputError
        Naming file, row and field, or when no star is bright enough.
    """
    faintest = limiting_magnitude + _MARGIN_MAG
    parts = [readers.read_tycho2(path, faintest) for path in tycho2]
    letters = [np.where(p.epoch == 2000.0, "T", "X") for p in parts]
    if supplement is not None:
        parts.append(readers.read_supplement(supplement, faintest))
        letters.append(np.full(len(parts[-1].hip), "S"))
    hip_stars = None if hipparcos is None else readers.read_hipparcos(hipparcos)
    stars, source = combine(readers.join(parts), np.concatenate(letters), hip_stars)
    paths = [*tycho2, *_given(supplement), *_given(hipparcos)]
    kept = stars.magnitude <= limiting_magnitude
    if not kept.any():
        raise InputError(f"{paths[0]}: no star down to magnitude {limiting_magnitude:g}")
    stars, source = stars.take(kept), source[kept]
    provenance = _provenance(paths, stars, source, limiting_magnitude)
    provenance["warnings"] = _missing_rows(
        {"tycho2": tycho2, "supplement": _given(supplement), "hipparcos": _given(hipparcos)}
    )
    return _catalogue(stars, source, provenance)


def _given(path: Path | None) -> list[Path]:
    return [] if path is None else [path]


def _missing_rows(files: Mapping[str, Sequence[Path]]) -> list[str]:
    warnings = []
    for kind, paths in files.items():
        name, length, official = _OFFICIAL[kind]
        found = sum(count_records(path, length) for path in paths)
        if paths and found != official:
            listed = ", ".join(map(str, paths))
            warnings.append(f"{listed}: {found:,} rows; the whole {name} has {official:,}")
    return warnings


def combine(
    stars: SourceStars, source: Letters, hipparcos: SourceStars | None
) -> tuple[SourceStars, Letters]:
    """Return Tycho-2 stars joined with Hipparcos-2 at J2000.0, and the source letters (N,)."""
    stars = at_j2000(stars)
    _, first = np.unique(stars.tycho_id, return_index=True)
    first.sort()
    stars, source = _fold_shared_light(stars.take(first), source[first])
    if hipparcos is None:
        return stars, source
    hipparcos = at_j2000(hipparcos)
    _, first = np.unique(hipparcos.hip, return_index=True)
    hipparcos = hipparcos.take(first)
    stars = _number_by_place(stars, hipparcos)
    stars, source = _take_astrometry(stars, source, hipparcos)
    missing = hipparcos.take(~np.isin(hipparcos.hip, stars.hip))
    return readers.join([stars, missing]), np.append(source, np.full(len(missing.hip), "h"))


def at_j2000(stars: SourceStars) -> SourceStars:
    """Return the stars with positions and motions moved from their epochs to J2000.0."""
    direction, motion = propagate(stars.direction, stars.motion, 2000.0 - stars.epoch)
    epoch = np.where(stars.has_motion, 2000.0, stars.epoch)
    return replace(stars, direction=direction, motion=motion, epoch=epoch)


def _fold_shared_light(stars: SourceStars, source: Letters) -> tuple[SourceStars, Letters]:
    """Fold components of one Hipparcos number that list the same, their combined, magnitude.

    Each would count the light of the pair again; one row in the middle is left of them.
    """
    alone = np.arange(len(stars.hip)) + 1
    key = np.stack((stars.hip, stars.magnitude, np.where(stars.hip > 0, 0, alone)), axis=1)
    _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
    group, size = group.reshape(-1), len(first)
    several = np.bincount(group, minlength=size) > 1
    if not several.any():
        return stars, source
    direction, motion = merging.photocentre(
        group, np.ones(len(group)), stars.direction, stars.motion, size
    )
    order = np.argsort(first)
    folded, several = stars.take(first[order]), several[order]
    spread = several[:, None]
    return replace(
        folded,
        direction=np.where(spread, direction[order], folded.direction),
        motion=np.where(spread, motion[order], folded.motion),
        multiple=folded.multiple | several,
        merged=folded.merged | several,
    ), source[first[order]]


def _number_by_place(stars: SourceStars, hipparcos: SourceStars) -> SourceStars:
    """Give stars without a Hipparcos number that of an unclaimed Hipparcos star on their place."""
    free = hipparcos.take(~np.isin(hipparcos.hip, stars.hip))
    if len(free.hip) == 0 or len(stars.hip) == 0:
        return stars
    distance, row = cKDTree(stars.direction).query(free.direction)
    row = np.asarray(row, dtype=np.int64)
    same = (distance < SAME_STAR_RAD) & (stars.hip[row] == 0)
    hip = stars.hip.copy()
    hip[row[same]] = free.hip[same]
    return replace(stars, hip=hip)


def _take_astrometry(
    stars: SourceStars, source: Letters, hipparcos: SourceStars
) -> tuple[SourceStars, Letters]:
    """Take parallaxes, and astrometry and colour of single matches, from Hipparcos-2."""
    size = int(max(stars.hip.max(initial=0), hipparcos.hip.max())) + 1
    row_of = np.full(size, -1)
    row_of[hipparcos.hip] = np.arange(len(hipparcos.hip))
    row = np.where(stars.hip > 0, row_of[stars.hip], -1)
    found = row >= 0
    other = hipparcos.take(row)  # row -1 is masked out below
    _, back, entries = np.unique(stars.hip, return_inverse=True, return_counts=True)
    single = found & (entries[back.reshape(-1)] == 1)
    distance = np.linalg.norm(stars.direction - other.direction, axis=1)
    better = single & (distance < SAME_STAR_RAD)
    column = better[:, None]
    joined = replace(
        stars,
        direction=np.where(column, other.direction, stars.direction),
        motion=np.where(column, other.motion, stars.motion),
        has_motion=stars.has_motion | better,
        epoch=np.where(better, 2000.0, stars.epoch),
        parallax=np.where(found, other.parallax, stars.parallax),
        colour=np.where(better & np.isfinite(other.colour), other.colour, stars.colour),
        multiple=stars.multiple | (found & other.multiple),
    )
    return joined, np.where(better, "H", source)


def _catalogue(stars: SourceStars, source: Letters, provenance: dict[str, Any]) -> StarCatalogue:
    order = np.lexsort((stars.tycho_id, stars.hip, stars.magnitude))
    stars, source = stars.take(order), source[order]
    # The brightest star of a Hipparcos number bears it, further components their Tycho number.
    brightest = np.zeros(len(order), dtype=np.bool_)
    brightest[np.unique(stars.hip, return_index=True)[1]] = True
    catalogue = StarCatalogue(
        star_id=np.where((stars.hip > 0) & brightest, stars.hip, stars.tycho_id),
        direction=stars.direction,
        motion=stars.motion,
        parallax=np.maximum(np.nan_to_num(stars.parallax), 0.0),
        magnitude=stars.magnitude,
        colour=stars.colour,
        multiple=stars.multiple,
        merged=stars.merged,
        source=source,
        provenance=provenance,
    )
    return catalogue.take(np.lexsort((catalogue.star_id, catalogue.magnitude)))


def _provenance(
    paths: Sequence[Path], stars: SourceStars, source: Letters, limiting_magnitude: float
) -> dict[str, Any]:
    letters, counts = np.unique(source, return_counts=True)
    return {
        "title": f"Stars to V {limiting_magnitude:g} from the official files",
        "frame": "ICRS",
        "epoch": "J2000.0",
        "limiting_magnitude": limiting_magnitude,
        "made_by": "stcal catalog build",
        "inputs": {path.name: _sha256_of(path) for path in paths},
        "references": [
            "Hog et al. 2000, A&A 355, L27 (Tycho-2, CDS I/259)",
            "van Leeuwen 2007, A&A 474, 653 (Hipparcos-2, CDS I/311)",
        ],
        "sources": {letter: SOURCES[letter] for letter in letters.tolist()},
        "counts": {
            "stars": len(source),
            "by_source": dict(zip(letters.tolist(), counts.tolist(), strict=True)),
            "negative_parallaxes_set_to_zero": int((stars.parallax < 0).sum()),
            "without_proper_motion": int((~stars.has_motion).sum()),
            "without_colour": int(np.isnan(stars.colour).sum()),
        },
    }


def _sha256_of(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
