import math
import os
import threading
import time
from concurrent.futures import Future

import pytest

from stcal.errors import InputError, UsageError, WorkerError
from stcal.execution import SCHEDULERS, _on_cluster, scheduler, serial


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


def test_only_a_few_items_run_ahead():
    """Else the results of a long run would pile up in memory while the first is waited for."""
    taken = []

    def items():
        for item in range(1000):
            taken.append(item)
            yield item

    with scheduler(2) as mapper:
        results = mapper(lambda x: x, items())
        assert next(results) == 0
        time.sleep(0.1)
        assert len(taken) < 20
        assert list(results) == list(range(1, 1000))


@pytest.mark.parametrize("name", list(SCHEDULERS))
def test_every_scheduler_maps(name):
    with scheduler(2, name) as mapper:
        assert list(mapper(math.factorial, range(8))) == [math.factorial(k) for k in range(8)]


def test_a_dead_worker_process_is_told():
    with scheduler(1, "processes") as mapper, pytest.raises(WorkerError, match="worker process"):
        list(mapper(os._exit, [3]))


def test_unknown_schedulers_are_refused():
    with (
        pytest.raises(UsageError, match="known: serial, threads, processes"),
        scheduler(2, "slurm"),
    ):
        pass
    with pytest.raises(InputError, match="no answer"), scheduler(2, "nonsense://127.0.0.1:1"):
        pass


@pytest.mark.parametrize(("largest", "sizes"), [(1, {1}), (20, {1, 20})])
def test_a_cluster_is_handed_batches_of_a_largest_size(largest, sizes):
    pytest.importorskip("distributed")

    class Cluster:
        """Does everything at once, and notes the sizes of the tasks."""

        def __init__(self):
            self.sizes = set()

        def nthreads(self):
            return {"tcp://worker": 1}

        def submit(self, timed, function, batch, **options):
            self.sizes.add(len(batch))
            done = Future()
            done.set_result(timed(function, batch))
            return done

    client = Cluster()
    items = range(3 + 5 * 20)
    assert list(_on_cluster(client, largest)(abs, items)) == list(items)
    assert client.sizes == sizes
