"""A Dask cluster of processes over loopback: the same answers, also when a worker is killed."""

import subprocess
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, st16_config, st16_matcher
from dask_cluster import cluster

from stcal.calibration import load
from stcal.execution import scheduler, serial
from stcal.pipeline.fit import fit_batch
from stcal.pipeline.scratch import scratch_folder
from stcal.pipeline.validate import validate
from stcal.telemetry.ingest import ingest
from stcal.telemetry.store import Store

pytest.importorskip("distributed")

SENSOR = "ST16-4"
HASHES = {"baseline": "b" * 64, "candidate": "c" * 64}


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Store:
    made = Store.open(tmp_path_factory.mktemp("cluster") / "store", create=True)
    ingest([ROOT / "sample_telemetry" / f"{SENSOR}.calibration.csv.gz"], made, [st16_config()])
    return made


def fitted(store: Store, mapper, out: Path):
    fragments = store.fragments(SENSOR, maximum_frames=32)
    initial = load(ROOT / "sample_telemetry" / f"{SENSOR}.initial.json")
    out.mkdir()
    with scratch_folder(out) as scratch:
        result = fit_batch(fragments, initial, st16_matcher(), {}, mapper=mapper, scratch=scratch)
    assert result.accepted
    return fragments, initial, result


def comparable(document: dict) -> dict:
    return {key: value for key, value in document.items() if key != "created_utc"}


def killing(mapper, process: subprocess.Popen, after: int):
    """Return the map; it kills a process after so many results, while others are on the way."""
    left = [after]

    def mapped(function, items):
        for result in mapper(function, items):
            left[0] -= 1
            if left[0] == 0:
                process.kill()
            yield result

    return mapped


def test_a_killed_worker_changes_nothing(store, tmp_path):
    fragments, initial, alone = fitted(store, serial, tmp_path / "alone")
    assert len(fragments) > 10
    with cluster(tmp_path, 2) as (address, workers), scheduler(1, address) as mapper:
        spoilt = killing(mapper, workers[0], after=40)
        _, _, shared = fitted(store, spoilt, tmp_path / "shared")
        assert workers[0].wait(10) == -9
        candidate = shared.calibration
        document = validate(fragments, initial, candidate, st16_matcher(), HASHES, mapper=mapper)
    assert comparable(alone.document) == comparable(shared.document)
    for name in ("c_sd", "covariance"):
        assert np.array_equal(getattr(alone.calibration, name), getattr(candidate, name))
    expected = validate(fragments, initial, candidate, st16_matcher(), HASHES)
    assert comparable(document) == comparable(expected)


def test_processes_give_the_same_bits(store, tmp_path):
    _, _, alone = fitted(store, serial, tmp_path / "alone")
    with scheduler(2, "processes") as mapper:
        _, _, shared = fitted(store, mapper, tmp_path / "shared")
    assert comparable(alone.document) == comparable(shared.document)
    assert not list(tmp_path.glob("*/.scratch-*"))


def test_items_are_batched_in_order_and_errors_pass(tmp_path):
    with cluster(tmp_path, 1) as (address, _), scheduler(1, address) as mapper:
        assert list(mapper(abs, range(0, -2000, -1))) == list(range(2000))
        with pytest.raises(ZeroDivisionError):
            list(mapper(partial(divmod, 1), [0]))
