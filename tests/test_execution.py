import threading

import pytest

from stcal.execution import scheduler, serial


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_come_in_the_order_of_the_items(workers):
    with scheduler(workers) as mapper:
        assert list(mapper(lambda x: x * x, range(100))) == [x * x for x in range(100)]


def test_work_is_shared():
    with scheduler(2) as mapper:
        barrier = threading.Barrier(2, timeout=10)
        # Passes only when both items are worked on at once.
        assert list(mapper(lambda _: barrier.wait() >= 0, range(2))) == [True, True]


def test_errors_pass():
    with scheduler(2) as mapper, pytest.raises(ZeroDivisionError):
        list(mapper(lambda x: 1 / x, [1, 0]))
    assert list(serial(str, [1, 2])) == ["1", "2"]
