"""What a catalogue holds, as one JSON object."""

from __future__ import annotations

from typing import Any

import numpy as np

from stcal.catalog.catalogue import StarCatalogue, catalogue_sha256
from stcal.constants import MAS


def summarise(catalogue: StarCatalogue) -> dict[str, Any]:
    """Return counts by magnitude and by source, flags, epoch, provenance and SHA-256."""
    # A star at the limit itself belongs to the bin that the limit closes: from < V <= to.
    upper = np.ceil(catalogue.magnitude).astype(np.int64)
    bins, counts = np.unique(upper, return_counts=True)
    letters, by_source = np.unique(catalogue.source, return_counts=True)
    known = catalogue.provenance.get("sources", {})
    motion = np.linalg.norm(catalogue.motion, axis=1)
    return {
        "stars": catalogue.n_stars,
        "sha256": catalogue_sha256(catalogue),
        "epoch": "J2000.0",
        "frame": "ICRS",
        "brightest": float(catalogue.magnitude.min()),
        "faintest": float(catalogue.magnitude.max()),
        "by_magnitude": [
            {"from": int(high) - 1, "to": int(high), "stars": int(n), "so_far": int(total)}
            for high, n, total in zip(bins, counts, np.cumsum(counts), strict=True)
        ],
        "by_source": [
            {"source": str(letter), "stars": int(n), "meaning": str(known.get(str(letter), ""))}
            for letter, n in zip(letters, by_source, strict=True)
        ],
        "multiple": int(catalogue.multiple.sum()),
        "merged": int(catalogue.merged.sum()),
        "with_parallax": int((catalogue.parallax > 0).sum()),
        "with_motion": int((motion > 0).sum()),
        "with_colour": int(np.isfinite(catalogue.colour).sum()),
        "fastest_mas_per_year": float(motion.max() / MAS),
        "warnings": catalogue.provenance.get("warnings", []),
        "provenance": catalogue.provenance,
    }
