"""Images of known stars: what a study takes that judges the calibration, not the identification.

An image is a telemetry frame with one exposure; the other is empty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import residual_angles, solve_wahba
from stcal.cameras import Camera
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.frames import FrameBatch, MatchedFrames
from stcal.simulate.detector import image
from stcal.simulate.sky import Sky, stars_in_cones
from stcal.simulate.true_camera import field_of_view

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Fewer stars fix no attitude.
_LEAST_STARS = 3
_NS = 1e9


@dataclass(frozen=True)
class KnownImages:
    """Where the stars of each image truly fall, as columns over stars (K,), image after image.

    Attributes
    ----------
    t_s : (F,) time of each image since the first
    image : (K,) which image, 0..F-1, rising
    star : (K,) row of the sky's catalogue
    s_i : (K, 3) unit star vectors in I, of the catalogue's epoch
    row_px, col_px : (K,) true centroids
    """

    t_s: Floats
    image: Ints
    star: Ints
    s_i: Floats
    row_px: Floats
    col_px: Floats

    @property
    def n_images(self) -> int:
        """Number of images F."""
        return len(self.t_s)

    @property
    def offsets(self) -> Ints:
        """(F + 1,) ranges of the images."""
        counts = np.bincount(self.image, minlength=self.n_images)
        return np.concatenate(([0], np.cumsum(counts)))

    def between(self, first: int, last: int) -> KnownImages:
        """Return images ``first`` to ``last`` - 1, numbered anew."""
        a, b = self.offsets[[first, last]]
        return KnownImages(
            self.t_s[first:last] - self.t_s[first],
            self.image[a:b] - first,
            self.star[a:b],
            self.s_i[a:b],
            self.row_px[a:b],
            self.col_px[a:b],
        )


def known_images(camera: Camera, c_di: Floats, t_s: Floats, sky: Sky) -> KnownImages:
    """Return the images that a camera takes of a sky at attitudes c_di (F, 3, 3).

    The stars stand where the catalogue has them: without aberration, as the paper's.
    """
    middle, radius = field_of_view(camera, camera.parameters[None])
    number, star = stars_in_cones(sky, middle @ c_di, radius)
    s_i = sky.catalogue.direction[star]
    row, col, seen = image(camera, np.einsum("kij,kj->ki", c_di[number], s_i))
    return KnownImages(t_s, number[seen], star[seen], s_i[seen], row[seen], col[seen])


def matched_images(
    images: KnownImages, row_px: Floats, col_px: Floats, camera: Camera, sensor_id: str, epoch: int
) -> MatchedFrames:
    """Return the images as telemetry with its matches; attitudes are solved with ``camera``.

    Parameters
    ----------
    row_px, col_px : (K,) measured centroids
    epoch : TAI ns of the first image
    """
    frames = _telemetry(images, row_px, col_px, sensor_id, epoch)
    s_d, exposure = camera.directions(row_px, col_px), frames.exposure_of_star
    count = frames.stars_per_exposure
    c_di = solve_wahba(s_d, images.s_i, np.ones(len(s_d)), exposure, frames.n_exposures)
    c_di[count < _LEAST_STARS] = np.nan
    return MatchedFrames(
        frames=frames,
        star=images.star.astype(np.int32),
        s_i=images.s_i,
        solved=count >= _LEAST_STARS,
        reason=np.where(count >= _LEAST_STARS, 0, 1).astype(np.int8),
        c_di=c_di,
        residual=residual_angles(s_d, images.s_i, c_di[exposure]),
    )


def _telemetry(
    images: KnownImages, row_px: Floats, col_px: Floats, sensor_id: str, epoch: int
) -> FrameBatch:
    """Return the telemetry: only times and centroids are known."""
    count, stars = images.n_images, len(row_px)
    unknown = np.full((count, 3), np.nan)
    no = np.zeros(count, dtype=np.bool_)
    # Exposure 1 begins and ends where exposure 0 ends.
    offsets = np.concatenate(([0], np.repeat(images.offsets[1:], EXPOSURES_PER_FRAME)))
    return FrameBatch(
        sensor_id=sensor_id,
        frame_id=np.arange(1, count + 1),
        t_tai_ns=epoch + np.round(images.t_s * _NS).astype(np.int64),
        best_exposure=np.full(count, -1, dtype=np.int8),
        q_si=np.full((count, 4), np.nan),
        rate_deg_s=unknown,
        temperature_c=np.full(count, np.nan),
        eclipse=no,
        intrusion=no,
        pos_km=unknown,
        vel_km_s=unknown,
        star_offsets=offsets,
        row_px=row_px,
        col_px=col_px,
        intensity=np.full(stars, np.nan),
        star_id=np.zeros(stars, dtype=np.int64),
    )
