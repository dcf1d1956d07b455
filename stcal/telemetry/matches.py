"""Matched stars and attitudes as Parquet files."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

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
from stcal.frames import Fragment, MatchedFrames
from stcal.matching import REASONS, Matcher, match
from stcal.pipeline.sums import Sums, total
from stcal.residuals.selection import centroid_sd
from stcal.times import utc_from_tai_ns

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MatchTables:
    """What a fragment adds to the files, and its counts.

    Attributes
    ----------
    matches : one row per star of every exposure; ``star_id`` is empty where unmatched
    attitudes : one row per frame: the quaternion of its better exposure, null without a fix;
        ``cov_xx_urad2`` and so on are the covariance of the small rotation error about the axes of
        S under the configured centroid noise
    """

    matches: pa.Table
    attitudes: pa.Table
    counts: MatchCounts


@dataclass(frozen=True)
class MatchCounts(Sums):
    """Numbers that add up: (R,) exposures by reason, and the squared residuals [rad^2]."""

    frames: int
    frames_solved: int
    stars: int
    matched_stars: int
    squares: float
    reasons: NDArray[np.int64]


@dataclass(frozen=True)
class MakeTables:
    """The pass that identifies a fragment's stars and makes its tables."""

    calibration: Calibration
    matcher: Matcher
    method: str

    def __call__(self, fragment: Fragment) -> MatchTables:
        """Identify one fragment's stars."""
        calibration, matcher = self.calibration, self.matcher
        part = match(fragment.read(), calibration.camera, calibration.c_sd, matcher, self.method)
        return MatchTables(
            _matches(part, matcher.catalogue),
            _attitudes(part, calibration, matcher.config.noise),
            _counts(part),
        )


def write_tables(parts: Iterable[MatchTables], matches: Path, attitudes: Path) -> MatchCounts:
    """Write both files, fragment by fragment, and return the counts of all."""
    counts: list[MatchCounts] = []

    def fill(first: BinaryIO, second: BinaryIO) -> None:
        with ExitStack() as stack:
            writers: list[pq.ParquetWriter] = []
            for part in parts:
                tables = (part.matches, part.attitudes)
                if not writers:
                    writers = [
                        stack.enter_context(
                            pq.ParquetWriter(stream, table.schema, compression="zstd")
                        )
                        for stream, table in zip((first, second), tables, strict=True)
                    ]
                for writer, table in zip(writers, tables, strict=True):
                    writer.write_table(table)
                counts.append(part.counts)

    write_with(matches, lambda a: write_with(attitudes, lambda b: fill(a, b)))
    return total(counts)


def _matches(part: MatchedFrames, catalogue: StarCatalogue) -> pa.Table:
    frames, exposure = part.frames, part.frames.exposure_of_star
    names = pa.array([*decode(catalogue.star_id), ""], pa.string())
    # Index -1 is the empty name at the end.
    place = np.where(part.star >= 0, part.star, len(names) - 1)
    return pa.table(
        {
            "frame_id": frames.frame_id[exposure // EXPOSURES_PER_FRAME],
            "exposure": (exposure % EXPOSURES_PER_FRAME).astype(np.int8),
            "row_px": frames.row_px,
            "col_px": frames.col_px,
            "star_id": names.take(pa.array(place)),
            "residual_urad": pa.array(part.residual / URAD, from_pandas=True),
        }
    )


def _attitudes(part: MatchedFrames, calibration: Calibration, noise: Noise) -> pa.Table:
    q_si, best = frame_quaternions(part, calibration.c_sd)
    utc = utc_from_tai_ns(part.frames.t_tai_ns)
    columns: dict[str, Any] = {
        "frame_id": part.frames.frame_id,
        "time_utc": pa.array(utc, pa.timestamp("ns", tz="UTC")),
        "best_exposure": pa.array(best, mask=best < 0),
    }
    for k, name in enumerate(("q_x", "q_y", "q_z", "q_w")):
        columns[name] = pa.array(q_si[:, k], from_pandas=True)
    covariance = _covariances(part, best, calibration, noise) / URAD**2
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        name = f"cov_{'xyz'[i]}{'xyz'[j]}_urad2"
        columns[name] = pa.array(covariance[:, i, j], from_pandas=True)
    columns["matched_stars"] = part.matches_per_frame
    return pa.table(columns)


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


def _counts(part: MatchedFrames) -> MatchCounts:
    residual = part.residual[np.isfinite(part.residual)]
    return MatchCounts(
        frames=part.frames.n_frames,
        frames_solved=int(part.frame_solved.sum()),
        stars=part.frames.n_stars,
        matched_stars=len(residual),
        squares=float((residual**2).sum()),
        reasons=np.bincount(part.reason, minlength=len(REASONS)),
    )


def summary(counts: MatchCounts) -> dict[str, Any]:
    """Return counts of frames, exposures and stars, and why exposures stayed unsolved."""
    matched = counts.matched_stars
    return {
        "frames": counts.frames,
        "frames_solved": counts.frames_solved,
        "exposures": int(counts.reasons.sum()),
        "exposures_solved": int(counts.reasons[0]),
        "stars": counts.stars,
        "matched_stars": matched,
        "unsolved": {REASONS[k]: int(counts.reasons[k]) for k in range(1, len(REASONS))},
        "rms_residual_urad": math.sqrt(counts.squares / matched) / URAD if matched else None,
    }
