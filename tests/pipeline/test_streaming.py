"""Fits and validations over many fragments: the same answers, and few frames in memory."""

import gc
import itertools
import weakref
from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import simulation, st16_matcher

from stcal.frames import FrameBatch
from stcal.pipeline.fit import fit_batch
from stcal.pipeline.pieces import THINNED, pieces_of, step_for, thinned
from stcal.pipeline.scratch import FolderScratch, MemoryScratch, scratch_folder
from stcal.pipeline.validate import validate

STARS = ("row_px", "col_px", "intensity", "star_id")
HASHES = {"baseline": "b" * 64, "candidate": "c" * 64}


def cut(frames: FrameBatch, count: int) -> list[FrameBatch]:
    edges = np.linspace(0, frames.n_frames, count + 1).astype(int)
    return [frames.take(np.arange(a, b)) for a, b in itertools.pairwise(edges)]


def blind(frames: FrameBatch) -> FrameBatch:
    """Frames without detections."""
    none = {name: getattr(frames, name)[:0] for name in STARS}
    return replace(frames, star_offsets=np.zeros_like(frames.star_offsets), **none)


@pytest.fixture(scope="module")
def data():
    return simulation(4, 81, 300)


@pytest.fixture(scope="module")
def whole(data):
    return fit_batch([data.calibration.frames], data.initial, st16_matcher(), {})


def test_a_thinned_start_ends_in_the_solution_of_all_frames(data, whole):
    parts = cut(data.calibration.frames, 3 * THINNED)
    found = fit_batch(parts, data.initial, st16_matcher(), {})
    assert found.accepted
    for key in ("frames", "frames_solved", "matched_stars", "span"):
        assert found.document[key] == whole.document[key]
    # Outliers are judged by the sample's camera and scale: a star or two at the limit may differ.
    assert abs(found.document["stars_used"] - whole.document["stars_used"]) < 10
    sd = np.sqrt(np.diag(whole.calibration.covariance))
    x, y = (r.calibration.camera.parameters for r in (found, whole))
    assert (np.abs(x - y) < 0.1 * sd).all()
    ratio = np.diag(found.calibration.covariance) / sd**2
    assert ratio == pytest.approx(1.0, abs=0.01)
    fitted = [r.document["rms_urad"]["fitted"] for r in (found, whole)]
    assert fitted[0] == pytest.approx(fitted[1], rel=2e-3)
    # Cameras that are only matched with are those of the sample.
    *rough, last = [cycle["stars_fitted"] for cycle in found.document["cycles"]]
    assert last == found.document["stars_used"]
    assert rough
    assert max(rough) < 0.5 * last


def test_a_sample_without_stars_is_made_up_for_by_the_rest(data):
    """Telemetry in which every fragment of the even sample is blind."""
    parts = cut(data.calibration.frames, 2 * THINNED)
    for k in range(0, len(parts), 2):
        parts[k] = blind(parts[k])
    found = fit_batch(parts, data.initial, st16_matcher(), {})
    seen = fit_batch(parts[1::2], data.initial, st16_matcher(), {})
    assert found.accepted
    assert found.document["stars_used"] == pytest.approx(seen.document["stars_used"], abs=10)
    sd = np.sqrt(np.diag(seen.calibration.covariance))
    x, y = (r.calibration.camera.parameters for r in (found, seen))
    assert (np.abs(x - y) < 0.3 * sd).all()


def test_a_scratch_of_files_gives_the_same_bits(data, tmp_path):
    parts = cut(data.calibration.frames, 5)
    inside = fit_batch(parts, data.initial, st16_matcher(), {}, scratch=MemoryScratch())
    with scratch_folder(tmp_path) as scratch:
        outside = fit_batch(parts, data.initial, st16_matcher(), {}, scratch=scratch)
    documents = [r.document | {"created_utc": ""} for r in (inside, outside)]
    assert documents[0] == documents[1]
    assert not list(tmp_path.iterdir())


@dataclass
class Counted:
    """A fragment that counts how many of its kind have their frames in memory."""

    frames: FrameBatch
    alive: list[int]

    @property
    def sensor_id(self):
        return self.frames.sensor_id

    @property
    def n_frames(self):
        return self.frames.n_frames

    @property
    def span_tai_ns(self):
        return self.frames.span_tai_ns

    def read(self):
        batch = self.frames.take(np.arange(self.n_frames))
        self.alive[0] += 1
        self.alive[1] = max(self.alive)
        weakref.finalize(batch.row_px, self.gone)
        return batch

    def gone(self):
        self.alive[0] -= 1


def test_few_fragments_are_in_memory_at_once(data, tmp_path):
    alive = [0, 0]
    parts = [Counted(frames, alive) for frames in cut(data.calibration.frames, 40)]
    gc.disable()  # cycles would free them only now and then, and hide that they are kept
    try:
        with scratch_folder(tmp_path) as scratch:
            result = fit_batch(parts, data.initial, st16_matcher(), {}, scratch=scratch)
        validate(parts, data.initial, result.calibration, st16_matcher(), HASHES)
    finally:
        gc.enable()
    assert alive[1] <= 3


def test_validation_of_many_fragments_is_that_of_one(data):
    frames = data.validation.frames
    one = validate([frames], data.initial, data.true, st16_matcher(), HASHES)
    many = validate(cut(frames, THINNED), data.initial, data.true, st16_matcher(), HASHES)
    for key in ("availability", "matched_stars", "matched_star_ratio", "pairs", "series"):
        assert one[key] == many[key]
    for key in ("rms_ratio", "attitude_offset_arcsec"):
        assert many[key] == pytest.approx(one[key], rel=1e-9)
    assert many["field"]["count"] == one["field"]["count"]
    assert many["field"]["after_row_px"] == pytest.approx(one["field"]["after_row_px"], abs=1e-9)


def test_pieces_are_numbered_and_thinned_evenly(data):
    parts = cut(data.calibration.frames, 100)
    empty = data.calibration.frames.take(np.arange(0))
    pieces = pieces_of([empty, *parts])
    assert [piece.number for piece in pieces] == list(range(100))
    few = thinned(pieces)
    assert len(few) <= THINNED
    assert set(np.diff([piece.number for piece in few])) == {-(-100 // THINNED)}
    assert thinned(pieces[:THINNED]) == pieces[:THINNED]
    step = step_for(pieces, 70)
    numbers = np.concatenate([piece.first + piece.every(step) for piece in pieces])
    assert np.array_equal(numbers, np.arange(0, data.calibration.frames.n_frames, step))


def test_a_living_scratch_is_left_alone_and_a_dead_one_removed(tmp_path):
    dead = tmp_path / ".scratch-dead"
    dead.mkdir()
    FolderScratch(dead).put("stars", 0, np.arange(3))
    with scratch_folder(tmp_path) as first:
        first.put("stars", 7, np.arange(3), np.array([[True]]))
        with scratch_folder(tmp_path) as second:
            assert first.folder != second.folder
            assert not dead.exists()
        numbers, flags = first.get("stars", 7)
        assert np.array_equal(numbers, np.arange(3))
        assert flags.dtype == np.bool_
        first.drop("stars")
        with pytest.raises(OSError):
            first.get("stars", 7)
    assert not list(tmp_path.iterdir())


def test_items_done_twice_change_nothing(data, tmp_path):
    """A cluster may run an item again after its worker died, when its files are there already."""

    def twice(function, items):
        for item in items:
            function(item)
            yield function(item)

    parts = cut(data.calibration.frames, 5)
    once = fit_batch(parts, data.initial, st16_matcher(), {})
    with scratch_folder(tmp_path) as scratch:
        again = fit_batch(parts, data.initial, st16_matcher(), {}, mapper=twice, scratch=scratch)
    documents = [r.document | {"created_utc": ""} for r in (once, again)]
    assert documents[0] == documents[1]
