"""The order of an exposure's stars is the plain algorithm's, which tries every swap."""

import numpy as np
import pytest

from stcal.residuals.ordering_kernels import flatness2, order_stars


def flatness(a, b, c):
    return flatness2(*a, *b, *c)


def test_flatness_is_the_sine_of_the_smallest_angle():
    """For small triangles on the sphere, by the cosine rule."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        v = np.column_stack([rng.uniform(-1e-3, 1e-3, (3, 2)), np.ones(3)])
        s = v / np.linalg.norm(v, axis=1, keepdims=True)
        c, b, a = (np.linalg.norm(s[i] - s[j]) for i, j in ((0, 1), (0, 2), (1, 2)))
        cosines = [
            (x * x + y * y - z * z) / (2 * x * y) for x, y, z in ((a, b, c), (b, c, a), (c, a, b))
        ]
        assert np.sqrt(flatness(*s)) == pytest.approx(np.sin(np.arccos(max(cosines))), rel=1e-3)


def flattest(s, order):
    values = [flatness(*s[list(order[k : k + 3])]) for k in range(len(order) - 2)]
    return min(values), int(np.argmin(values))


def plain_order(s):
    order = list(range(len(s)))
    for k in range(2, len(s) - 1):
        best = max(
            range(k, len(s)), key=lambda j: flatness(*s[[order[k - 2], order[k - 1], order[j]]])
        )
        order[k], order[best] = order[best], order[k]
    swaps = 0
    for _ in range(len(s)):
        worst, where = flattest(s, order)
        if worst >= 0.04:
            break
        tried = []
        for i in range(where, where + 3):
            for j in range(len(s)):
                swapped = order.copy()
                swapped[i], swapped[j] = swapped[j], swapped[i]
                tried.append((flattest(s, swapped)[0], swapped))
        best, swapped = max(tried, key=lambda one: one[0])
        if best <= worst:
            break
        order, swaps = swapped, swaps + 1
    return order, swaps


@pytest.mark.parametrize("stars", [2, 3, 4, 6, 9, 14])
def test_the_order_is_the_plain_algorithms(stars):
    rng = np.random.default_rng(stars)
    mended = 0
    for _ in range(30):
        v = np.column_stack([rng.uniform(-0.15, 0.15, (stars, 2)), np.ones(stars)])
        # Half of them nearly on a line, so that there is something to mend.
        v[::2, 1] *= 0.02
        s = v / np.linalg.norm(v, axis=1, keepdims=True)
        order = np.empty(stars, np.int64)
        order_stars(np.array([0, stars]), s, order)
        expected, swaps = plain_order(s) if stars > 2 else ([0, 1], 0)
        assert order.tolist() == expected
        mended += swaps > 0
    assert mended > 5 or stars < 4
