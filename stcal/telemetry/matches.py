"""Matched stars and attitudes as Parquet files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from stcal.atomic import write_with
from stcal.attitude import frame_quaternions, unweighted_covariance
from stcal.calibration import Calibration
from stcal.catalog.catalogue import StarCatalogue
from stcal.catalog.identifiers import decode
from stcal.config import Noise
from stcal.constants import EXPOSURES_PER_FRAME, URAD
from stcal.frames import MatchedFrames
from stcal.matching import REASONS
from stcal.residuals.selection import centroid_sd
from stcal.times import utc_from_tai_ns

Floats = NDArray[np.float64]


def write_matches(matched: Sequence[MatchedFrames], catalogue: StarCatalogue, path: Path) -> None:
    """Write one row per star of every exposure; ``star_id`` is empty where unmatched."""
    names = np.append(decode(catalogue.star_id), "")
    tables = []
    for part in matched:
        frames, exposure = part.frames, part.frames.exposure_of_star
        tables.append(
            pa.table(
                {
                    "frame_id": frames.frame_id[exposure // EXPOSURES_PER_FRAME],
                    "exposure": (exposure % EXPOSURES_PER_FRAME).astype(np.int8),
                    "row_px": frames.row_px,
                    "col_px": frames.col_px,
                    # Index -1 is the empty name at the end.
                    "star_id": pa.array(names[part.star].tolist(), pa.string()),
                    "residual_urad": pa.array(part.residual / URAD, from_pandas=True),
                }
            )
        )
    _write(pa.concat_tables(tables), path)


def write_attitudes(
    matched: Sequence[MatchedFrames], calibration: Calibration, noise: Noise, path: Path
) -> None:
    """Write one row per frame: the quaternion of its better exposure, null without a fix.

    ``cov_xx_urad2`` and so on are the covariance of the small rotation error about the axes of S
    under the configured centroid noise.
    """
    tables = []
    for part in matched:
        q_si, best = frame_quaternions(part, calibration.c_sd)
        columns: dict[str, Any] = {
            "frame_id": part.frames.frame_id,
            "time_utc": pa.array(
                utc_from_tai_ns(part.frames.t_tai_ns), pa.timestamp("ns", tz="UTC")
            ),
            "best_exposure": pa.array(best, mask=best < 0),
        }
        for k, name in enumerate(("q_x", "q_y", "q_z", "q_w")):
            columns[name] = pa.array(q_si[:, k], from_pandas=True)
        covariance = _covariances(part, best, calibration, noise) / URAD**2
        for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
            name = f"cov_{'xyz'[i]}{'xyz'[j]}_urad2"
            columns[name] = pa.array(covariance[:, i, j], from_pandas=True)
        columns["matched_stars"] = part.matches_per_frame
        tables.append(pa.table(columns))
    _write(pa.concat_tables(tables), path)


def _covariances(
    part: MatchedFrames, best: NDArray[np.int8], calibration: Calibration, noise: Noise
) -> Floats:
    """Return (F, 3, 3) rad^2 about the axes of S of each frame's better exposure, NaN without."""
    frames, camera, star = part.frames, calibration.camera, np.flatnonzero(part.is_matched)
    row, col = frames.row_px[star], frames.col_px[star]
    sd = centroid_sd(noise, frames.intensity[star]) * camera.noise_scale(row, col)
    in_d = unweighted_covariance(
        camera.directions(row, col), sd, frames.exposure_of_star[star], frames.n_exposures
    )
    exposure = EXPOSURES_PER_FRAME * np.arange(len(best)) + np.maximum(best, 0)
    in_s = calibration.c_sd @ in_d[exposure] @ calibration.c_sd.T
    in_s[best < 0] = np.nan
    return np.asarray(in_s)


def _write(table: pa.Table, path: Path) -> None:
    write_with(path, lambda stream: pq.write_table(table, stream, compression="zstd"))


def summary(matched: Sequence[MatchedFrames]) -> dict[str, Any]:
    """Return counts of frames, exposures and stars, and why exposures stayed unsolved."""
    reason = np.concatenate([m.reason for m in matched])
    residual = np.concatenate([m.residual for m in matched])
    residual = residual[np.isfinite(residual)]
    counts = np.bincount(reason, minlength=len(REASONS))
    return {
        "frames": sum(m.frames.n_frames for m in matched),
        "frames_solved": sum(int(m.frame_solved.sum()) for m in matched),
        "exposures": len(reason),
        "exposures_solved": int(counts[0]),
        "stars": sum(m.frames.n_stars for m in matched),
        "matched_stars": len(residual),
        "unsolved": {REASONS[k]: int(counts[k]) for k in range(1, len(REASONS))},
        "rms_residual_urad": (
            float(np.sqrt(np.mean(residual**2)) / URAD) if len(residual) else None
        ),
    }
