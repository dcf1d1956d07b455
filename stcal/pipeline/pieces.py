"""The fragments of a run, numbered, and even samples of their frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stcal.frames import Fragment, FrameBatch

Ints = NDArray[np.int64]

# Enough for figures, and to start a solution from.
THINNED = 16


@dataclass(frozen=True)
class Piece:
    """A fragment, its number, and the number of its first frame in the run."""

    number: int
    first: int
    fragment: Fragment

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self.fragment.n_frames

    def read(self) -> FrameBatch:
        """Return the frames."""
        return self.fragment.read()

    def every(self, step: int) -> Ints:
        """Return the frames, counted in the piece, whose number in the run ``step`` divides."""
        return np.arange(-self.first % step, self.n_frames, step)


def pieces_of(fragments: Sequence[Fragment]) -> list[Piece]:
    """Number the fragments that hold frames, in the order given."""
    filled = [fragment for fragment in fragments if fragment.n_frames]
    first = np.cumsum([0, *(fragment.n_frames for fragment in filled)]).tolist()
    return [Piece(k, first[k], fragment) for k, fragment in enumerate(filled)]


def thinned(pieces: Sequence[Piece]) -> list[Piece]:
    """Return at most THINNED pieces, evenly over the run: all of them when there are few."""
    return list(pieces[:: max(1, math.ceil(len(pieces) / THINNED))])


def step_for(pieces: Sequence[Piece], most: int) -> int:
    """Return the step between frames of an even sample of at most ``most`` frames."""
    return max(1, math.ceil(sum(piece.n_frames for piece in pieces) / most))
