"""Reading ahead keeps the order, passes errors on, and doesn't run away."""

from __future__ import annotations

import threading
import time
from functools import partial

import pytest

from stcal.telemetry.ahead import ahead


def numbers(k, n, started=None):
    if started is not None:
        started.append(k)
    for i in range(n):
        time.sleep(0.001 * ((7 * k + i) % 3))
        yield k, i


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_come_in_order(workers):
    sources = [partial(numbers, k, k % 4) for k in range(20)]
    with ahead(sources, workers) as readings:
        found = [list(results) for results in readings]
    assert found == [[(k, i) for i in range(k % 4)] for k in range(20)]


def test_an_error_is_raised_where_its_source_is_taken_in():
    def broken():
        yield 1
        raise ValueError("no more")

    with ahead([partial(numbers, 0, 2), broken, partial(numbers, 2, 2)], 3) as readings:
        assert len(list(next(readings))) == 2
        results = next(readings)
        assert next(results) == 1
        with pytest.raises(ValueError, match="no more"):
            next(results)


def test_few_sources_are_under_way_and_all_end_with_the_reader():
    started: list[int] = []
    before = threading.active_count()
    with ahead([partial(numbers, k, 50, started) for k in range(30)], 2) as readings:
        first = next(readings)
        assert next(first) == (0, 0)
        time.sleep(0.1)
        assert max(started) <= 2
    assert threading.active_count() == before
