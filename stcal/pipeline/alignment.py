"""The C_SD update: no realignment after a recalibration, Enright 2018 section II-C, last paragraph.

The cost doesn't see a bulk rotation, so the fitted camera's D frame may turn against the old one.
With c_di the attitude of an exposure in D, k = c_di(old) c_di(new)^T takes new D to old D; folding
its mean into C_SD gives c_sd(new) = c_sd(old) mean(k), which nulls the mean attitude offset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.attitude import mean_rotation
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.geometry.rotations import (
    matrix_from_vector,
    nearest_rotation,
    vector_from_matrix,
)

Floats = NDArray[np.float64]

# A mean over more frames gains nothing: its sd is a three hundredth of one frame's.
MOST_TURNS = 100_000


@dataclass(frozen=True)
class Alignment:
    """The updated alignment.

    Attributes
    ----------
    c_sd : (3, 3) the new C_SD
    offset : (3,) rad, about the axes of S: what the update takes out
    spread, sd_of_mean : (3,) rad, about the axes of S
    frames_used, frames_rejected : frames solved under both calibrations
    """

    c_sd: Floats
    offset: Floats
    spread: Floats
    sd_of_mean: Floats
    frames_used: int
    frames_rejected: int


def update_alignment(c_sd: Floats, turns: Floats) -> Alignment | None:
    """Return the update from rotations of :func:`frame_turns`, old over new; None without any."""
    mean = mean_rotation(turns)
    if mean is None:
        return None
    # Turns are taken in S here: mean = c_sd mean(k) c_sd^T.
    return Alignment(
        c_sd=nearest_rotation(mean.c @ c_sd),
        offset=vector_from_matrix(mean.c[None])[0],
        spread=mean.spread,
        sd_of_mean=mean.sd_of_mean,
        frames_used=int(mean.kept.sum()),
        frames_rejected=int((~mean.kept).sum()),
    )


def frame_turns(a: Floats, b: Floats) -> Floats:
    """Return one rotation a b^T for each frame with an exposure solved in both (E, 3, 3) lists.

    The mean of the frame's two exposures: they see nearly the same stars, so that they are no
    independent samples.
    """
    turns = a @ np.swapaxes(b, 1, 2)
    solved = np.isfinite(turns[:, 0, 0])
    first, second = turns[0::EXPOSURES_PER_FRAME], turns[1::EXPOSURES_PER_FRAME]
    has_first, has_second = solved[0::EXPOSURES_PER_FRAME], solved[1::EXPOSURES_PER_FRAME]
    both = has_first & has_second
    chosen = np.where(has_first[:, None, None], first, second)
    between = vector_from_matrix(second[both] @ np.swapaxes(first[both], 1, 2))
    chosen[both] = matrix_from_vector(0.5 * between) @ first[both]
    return np.asarray(chosen[has_first | has_second])
