"""Singular values of star groups with their derivatives, unweighted; Wu et al. 2019, section 3.3.

What the observability analysis and the published form of the filter need: the residual
``singular-values`` gives whitened rows only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def groups_of(offsets: Ints, model: int) -> tuple[Ints, Ints, Ints]:
    """Return (image, first star, size) of all star groups (G,) of a model, section 3.3.2.

    ``offsets`` (F + 1,) are the stars' ranges of the images.  Model 1 has three stars each (1-2-3,
    2-3-4, ...), model 2 half the stars, model 3 all but one; model 4 grows (1-2-3, 1-2-3-4, ...).
    """
    stars = np.diff(offsets)
    size = {1: np.full(len(stars), 3), 2: stars // 2, 3: stars - 1, 4: np.full(len(stars), 3)}
    smallest = np.maximum(size[model], 3)
    count = np.maximum(stars - smallest + 1, 0)
    image = np.repeat(np.arange(len(stars)), count)
    number = np.arange(len(image)) - np.repeat(np.cumsum(count) - count, count)
    first = offsets[image]
    if model == 4:
        return image, first, smallest[image] + number
    return image, first + number, smallest[image]


def singular_values(s: Floats, first: Ints, size: Ints) -> tuple[Floats, Floats]:
    """Return singular values (G, 3), largest first, and left vectors (G, 3, 3) of star groups.

    A group is ``size`` star vectors from ``first`` on of s (S, 3).
    """
    squares, vectors = np.linalg.eigh(_group_sums(s[:, :, None] * s[:, None, :], first, size))
    return np.sqrt(np.maximum(squares[:, ::-1], 0.0)), vectors[:, :, ::-1]


def derivatives(s: Floats, by_parameter: Floats, first: Ints, size: Ints) -> Floats:
    """Return derivatives (G, 3, P) of the singular values, from those of s (S, 3, P).

    d sigma_k = p_k^T dW q_k with q_k = W^T p_k / sigma_k.
    """
    sigma, p = singular_values(s, first, size)
    moved = _group_sums(s[:, :, None, None] * by_parameter[:, None, :, :], first, size)
    along = np.einsum("gik,gijp,gjk->gkp", p, moved, p, optimize=True)
    return np.asarray(along / sigma[:, :, None])


def _group_sums(terms: Floats, first: Ints, size: Ints) -> Floats:
    """Sum terms (S, ...) over each group (G, ...)."""
    # Sums run from every even place to the next, odd one; the last group may end at the end.
    closed = np.concatenate([terms, np.zeros((1, *terms.shape[1:]))])
    bounds = np.stack([first, first + size], axis=1).ravel()
    return np.asarray(np.add.reduceat(closed, bounds, axis=0)[::2])


def least_observable(rows: Floats, image: Ints, n_images: int) -> Floats:
    """Return the smallest singular value (F,) of each image's rows of H' (A, P), eqs (30)-(33).

    Zero for an image whose rows don't determine all parameters.
    """
    count = np.bincount(image, minlength=n_images)
    starts = np.cumsum(count) - count
    least = np.zeros(n_images)
    for size in np.unique(count[count >= rows.shape[1]]):
        chosen = np.flatnonzero(count == size)
        blocks = rows[starts[chosen][:, None] + np.arange(size)]
        values = np.linalg.svd(blocks, compute_uv=False)
        # Below rounding, as numpy.linalg.matrix_rank has it.
        rounding = values[:, 0] * max(blocks.shape[1:]) * np.finfo(np.float64).eps
        least[chosen] = np.where(values[:, -1] > rounding, values[:, -1], 0.0)
    return least
