"""A store at a URL: it reads as the folder that it was copied from, and is as hard to fool."""

import io
import json
import shutil
import socket
from functools import partial

import fsspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import s3_server
import telemetry_cases as cases

from stcal.errors import ConfigError, InputError
from stcal.execution import scheduler
from stcal.telemetry.configurations import recorded_for
from stcal.telemetry.fragments import fragments_sha256
from stcal.telemetry.places import place_of
from stcal.telemetry.quarantine_list import Selection, listing
from stcal.telemetry.store import Store
from stcal.telemetry.writer import write_csv
from stcal.times import parse_utc

SENSOR = "ST16-1"


@pytest.fixture(scope="module")
def filled(tmp_path_factory) -> Store:
    """Four days of one sensor, a frame of another one and a refused row."""
    folder = tmp_path_factory.mktemp("filled")
    write_csv([cases.batch(200)], folder / "a.csv", decimals=None)
    bad = cases.ROW | {"sensor_id": "ST16-é %", "row_px": "x"}
    other = cases.rows(3, sensor_id="ST16-é %")
    return cases.run(folder, folder / "a.csv", cases.write_rows(folder / "b.csv", [*other, bad]))[0]


class Files:
    """A store's copy at a URL, whose files can be changed from below."""

    def __init__(self, url, read, write):
        self.url, self.read, self.write = url, read, write
        self.store = Store.open(place_of(url))

    def change(self, name, change):
        self.write(name, change(self.read(name)))


@pytest.fixture(params=["file", "memory", "s3"])
def copy(request, filled, tmp_path, monkeypatch):
    if request.param == "file":
        root = tmp_path / "copy"
        shutil.copytree(filled.root, root)
        yield Files(
            f"file://{root}",
            lambda name: (root / name).read_bytes(),
            lambda name, content: (root / name).write_bytes(content),
        )
    elif request.param == "memory":
        system = fsspec.filesystem("memory")
        system.put(str(filled.root), "/team/store", recursive=True)
        at = "/team/store/{}".format
        yield Files(
            "memory://team/store",
            lambda name: system.cat_file(at(name)),
            lambda name, content: system.pipe_file(at(name), content),
        )
        system.rm("/team", recursive=True)
    else:
        with s3_server.served(monkeypatch) as bucket:
            bucket.fill(filled.root, "team/store")
            at = "team/store/{}".format
            yield Files(
                "s3://bucket/team/store",
                lambda name: bucket.objects[at(name)],
                lambda name, content: bucket.objects.__setitem__(at(name), content),
            )


def day(number):
    return f"frames/sensor={SENSOR}/day=2026-01-0{number}/frames.parquet"


def facts(fragment):
    own = ("path", "stamp")
    return {name: value for name, value in vars(fragment).items() if name not in own}


def test_reads_as_the_folder(filled, copy):
    assert copy.store.sensors() == filled.sensors() == [SENSOR, "ST16-é %"]
    for sensor in filled.sensors():
        here, there = (s.fragments(sensor, maximum_frames=7) for s in (filled, copy.store))
        assert list(map(facts, here)) == list(map(facts, there))
        root = str(filled.root)
        assert [str(f.path).replace(root, copy.url) for f in here] == [str(f.path) for f in there]
        cases.assert_same_frames(filled.read_frames(sensor), copy.store.read_frames(sensor))
        assert copy.store.sha256(sensor) == filled.sha256(sensor)
    start = filled.fragments(SENSOR)[2].span_tai_ns[0]
    assert copy.store.sha256(SENSOR, start) == filled.sha256(SENSOR, start)
    assert recorded_for(copy.store.root, SENSOR) == recorded_for(filled.root, SENSOR)
    assert copy.store.quarantine().equals(filled.quarantine())
    found = [listing(s.root, Selection()).document() for s in (filled, copy.store)]
    assert found[0] == found[1]
    assert found[0]["records"] == 1


@pytest.mark.parametrize("name", ["threads", "processes"])
def test_fragments_are_read_by_workers(filled, copy, name):
    if copy.url.startswith("memory") and name == "processes":
        pytest.skip("the memory is this process's")
    with scheduler(2, name) as mapper:
        found = fragments_sha256(SENSOR, copy.store.fragments(SENSOR), mapper)
    assert found == filled.sha256(SENSOR)


def test_what_is_not_there_is_said(copy):
    with pytest.raises(InputError, match="'ST16-9'; sensors in the store: ST16-1, ST16-é %"):
        copy.store.fragments("ST16-9")
    for url in (f"{copy.url}/frames", f"{copy.url}2"):
        with pytest.raises(InputError, match=rf"^{url}: no stcal store here"):
            Store.open(place_of(url))


def test_flipped_bits_and_lost_ends_are_seen(filled, copy):
    content, rng = copy.read(day(6)), np.random.default_rng(0)
    span = parse_utc("2026-01-06T00:00:00Z"), parse_utc("2026-01-07T00:00:00Z")
    whole = filled.sha256(SENSOR, *span)
    said = []
    for place in rng.integers(0, len(content), 12).tolist():
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        copy.write(day(6), bytes(damaged))
        try:
            assert copy.store.sha256(SENSOR, *span) == whole, place
        except InputError as error:
            said.append(str(error))
    assert len(said) > 5
    copy.write(day(6), content[: len(content) // 2])
    with pytest.raises(InputError) as caught:
        copy.store.fragments(SENSOR)
    assert all(f"{copy.url}/{day(6)}: damaged" in one for one in [*said, str(caught.value)])


def test_a_store_that_changes_under_a_reader(copy):
    fragments = copy.store.fragments(SENSOR)
    again = io.BytesIO()
    # The same frames, and as good: only what the back end says of the file tells.
    pq.write_table(pq.read_table(io.BytesIO(copy.read(day(5)))), again, compression="gzip")
    copy.write(day(5), again.getvalue())
    with pytest.raises(InputError, match="the store changed while it was read") as caught:
        fragments[0].read()
    assert f"{copy.url}/{day(5)}: " in str(caught.value)


def test_hostile_files_are_refused(copy, tmp_path):
    bomb = pa.table({"t_tai_ns": pa.array(np.zeros(60_000_000, np.int8))})
    path = tmp_path / "bomb.parquet"
    schema = pq.ParquetFile(pa.BufferReader(copy.read(day(5)))).schema_arrow
    bomb = bomb.replace_schema_metadata(schema.metadata)
    pq.write_table(bomb, path, compression="zstd", row_group_size=10**9)
    copy.write(day(5), path.read_bytes())
    with pytest.raises(InputError, match=rf"{copy.url}/{day(5)}: .*60000000 values"):
        copy.store.fragments(SENSOR)
    copy.write("configs/x.json", b"\xff")
    with pytest.raises(ConfigError, match=rf"{copy.url}/configs/x\.json: not JSON"):
        recorded_for(copy.store.root, SENSOR)
    newer = json.dumps({"schema": "stcal.store", "version": 2}).encode()
    for content, said in ((newer, "store version 2"), (b"[" * 100_000, "not JSON")):
        copy.write("store.json", content)
        with pytest.raises(InputError, match=rf"{copy.url}/store\.json: .*{said}"):
            Store.open(place_of(copy.url))


def test_is_not_written(copy):
    before = copy.read("store.json")
    for action in (
        partial(Store.open, place_of(f"{copy.url}/new"), create=True),
        partial(Store.open, place_of(copy.url), create=True),
        copy.store.lock,
        lambda: copy.store.read_day(SENSOR, "2026-01-05"),
    ):
        with pytest.raises(InputError, match="is written in a folder of a file system"):
            action()
    assert copy.read("store.json") == before


def test_what_a_bucket_refuses(monkeypatch):
    with s3_server.served(monkeypatch) as bucket:
        with pytest.raises(InputError, match=r"s3://none/x: no stcal .* or its bucket, is mis"):
            Store.open(place_of("s3://none/x"))
        with pytest.raises(InputError, match=r"s3://closed/x/store\.json: .*access refused"):
            Store.open(place_of("s3://closed/x"))
        # A key that a file system would take for a file outside of the store.
        bucket.objects["x/quarantine/../../etc/x.parquet"] = b""
        with pytest.raises(InputError, match="which no store has"):
            Store(place_of("s3://bucket/x")).quarantine()


def test_nobody_answers(monkeypatch):
    with s3_server.served(monkeypatch), socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))  # not listening
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{closed.getsockname()[1]}")
        monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
        with pytest.raises(
            InputError, match=r"s3://bucket/x/store\.json: cannot be read: Endpoint"
        ):
            Store.open(place_of("s3://bucket/x"))


def test_a_day_is_fetched_in_few_requests(filled, monkeypatch):
    with s3_server.served(monkeypatch) as bucket:
        bucket.fill(filled.root, "store")
        fragments = Store.open(place_of("s3://bucket/store")).fragments(SENSOR)
        bucket.requests.clear()
        fragments[0].read()
        sent = [request for request in bucket.requests if request.startswith("GET")]
    assert 1 <= len(sent) <= 3, sent
