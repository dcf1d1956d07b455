"""A run that stops after any frame goes on as if it had not; damaged states are refused."""

import copy
import json
from dataclasses import fields, replace

import numpy as np
import pytest
from conftest import simulation, st16_config, st16_matcher
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stcal.errors import InputError, UsageError
from stcal.matching import match
from stcal.pipeline.filter_run import filter_fragment, join_histories, unseen
from stcal.pipeline.filter_state import StateFile, load_state, save_state
from stcal.pipeline.filtering import Variant, make_filter
from stcal.pipeline.sequential import fit_sequential

FRAMES = 120
WINDOW = st16_config().sequential.window_frames
KEPT = st16_config().sequential.relinearised_frames
SETTING = {"sensor_id": "ST16-4", "method": "sqrf", "process_noise": {"f_m": 0.5}}


@pytest.fixture(scope="module")
def data():
    return simulation(4, 51, FRAMES)


@pytest.fixture(scope="module")
def baseline(data):
    return match(data.calibration.frames, data.initial.camera, data.initial.c_sd, st16_matcher())


def make(data, **variant):
    return make_filter(Variant(**variant), data.initial, st16_matcher())


def through_a_file(state, folder):
    save_state(StateFile(SETTING, {"constant": state}), folder / "state.json")
    return load_state(folder / "state.json", SETTING)["constant"]


def assert_same(a, b):
    for field in fields(a):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if isinstance(x, np.ndarray):
            assert x.shape == y.shape, field.name
            assert x.dtype == y.dtype, field.name
            assert np.array_equal(x, y, equal_nan=x.dtype.kind == "f"), field.name
        else:
            assert x == y, field.name


@pytest.fixture(scope="module")
def whole(data, baseline):
    """Each filter without an interruption."""
    variants = {
        "sqrf": {"process_noise": {"f_m": 0.5, "a1_rad": 0.1}},
        "ekf": {"precision": "single"},
        "ukf": {},
    }
    found = {}
    for method, options in variants.items():
        chosen = make(data, method=method, **options)
        found[method] = (chosen, *filter_fragment(chosen, baseline, chosen.start)[:2])
    return found


@pytest.mark.parametrize("method", ["sqrf", "ekf", "ukf"])
@pytest.mark.parametrize(
    "stop", [1, 2, WINDOW - 1, WINDOW, WINDOW + 1, KEPT - 1, KEPT, KEPT + 1, FRAMES - 1]
)
def test_an_interruption_changes_no_bit(whole, baseline, tmp_path, method, stop):
    chosen, state, history = whole[method]
    half, first, _ = filter_fragment(chosen, baseline.take(np.arange(stop)), chosen.start)
    again = through_a_file(half, tmp_path)
    assert_same(half, again)
    later = unseen(baseline, again)
    assert later.frames.n_frames == FRAMES - stop
    end, second, _ = filter_fragment(chosen, later, again)
    assert_same(end, state)
    assert_same(join_histories([first, second]), history)


def test_a_run_may_stop_within_a_fragment(data):
    """The whole stage: states, history and calibration after two runs are those of one."""
    frames = data.calibration.frames
    parts = [frames.take(np.arange(a, min(a + 50, FRAMES))) for a in range(0, FRAMES, 50)]
    variant = Variant(temperature=("f_m",))

    def fit(batches, states=None, before=None):
        return fit_sequential(
            batches, data.initial, st16_matcher(), {"parent_sha256": ""}, variant, states, before
        )

    once = fit(parts)
    early = fit([parts[0], parts[1].take(np.arange(20))])
    twice = fit(parts, early.states, {name: run.history for name, run in early.runs.items()})
    assert set(twice.states) == {"constant", "thermal"}
    for name, state in once.states.items():
        assert_same(twice.states[name], state)
        assert_same(twice.runs[name].history, once.runs[name].history)
    for result in (once, twice):
        del result.document["created_utc"]
    assert twice.document == once.document
    assert np.array_equal(twice.calibration.camera.parameters, once.calibration.camera.parameters)


def test_a_state_that_has_seen_everything_has_nothing_to_do(data, baseline):
    frames = data.calibration.frames

    def fit(states=None, before=None):
        return fit_sequential(
            [frames], data.initial, st16_matcher(), {"parent_sha256": ""}, Variant(), states, before
        )

    done = fit()
    with pytest.raises(UsageError, match="has seen all frames"):
        fit(done.states)
    again = fit(done.states, {"constant": done.history})
    assert_same(again.states["constant"], done.states["constant"])
    assert_same(again.history, done.history)


def test_a_state_after_a_fallback_can_be_read(data, baseline, tmp_path):
    """No frame is kept then: an empty list has lost its shape."""
    chosen = make(data)
    state, _, _ = filter_fragment(chosen, baseline.take(np.arange(40)), chosen.start)
    broken = replace(state, x=np.full(8, np.nan))
    after, history, _ = filter_fragment(chosen, baseline.take(np.arange(40, 41)), broken)
    assert history.event[0]
    assert len(after.kept_star) == 0
    again = through_a_file(after, tmp_path)
    rest = baseline.take(np.arange(41, FRAMES))
    assert_same(filter_fragment(chosen, rest, again)[0], filter_fragment(chosen, rest, after)[0])


def test_a_state_after_frames_without_stars_can_be_read(data, tmp_path):
    frames = data.calibration.frames
    seen = frames.exposure_of_star >= 6
    counts = np.bincount(frames.exposure_of_star[seen], minlength=frames.n_exposures)
    dark = replace(
        frames,
        star_offsets=np.concatenate(([0], np.cumsum(counts))),
        **{k: getattr(frames, k)[seen] for k in ("row_px", "col_px", "intensity", "star_id")},
    )
    baseline = match(dark, data.initial.camera, data.initial.c_sd, st16_matcher())
    chosen = make(data)
    whole, _, _ = filter_fragment(chosen, baseline, chosen.start)
    half, history, _ = filter_fragment(chosen, baseline.take(np.arange(3)), chosen.start)
    assert not history.matched.any()
    rest = baseline.take(np.arange(3, FRAMES))
    assert_same(filter_fragment(chosen, rest, through_a_file(half, tmp_path))[0], whole)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("sensor_id", "ST16-5"),
        ("method", "ekf"),
        ("process_noise", {"f_m": 0.6}),
        ("precision", "single"),
    ],
)
def test_a_state_of_another_run_is_refused_naming_the_difference(
    data, baseline, tmp_path, key, value
):
    state, _, _ = filter_fragment(make(data), baseline.take(np.arange(5)), make(data).start)
    path = tmp_path / "state.json"
    save_state(StateFile(SETTING, {"constant": state}), path)
    with pytest.raises(InputError) as caught:
        load_state(path, SETTING | {key: value})
    message = str(caught.value)
    assert str(path) in message
    assert key in message
    assert repr(value) in message


@pytest.fixture(scope="module")
def saved(data, baseline, tmp_path_factory):
    state, _, _ = filter_fragment(make(data), baseline.take(np.arange(6)), make(data).start)
    path = tmp_path_factory.mktemp("saved") / "state.json"
    save_state(StateFile(SETTING, {"constant": state}), path)
    return path.read_text()


def refused(path):
    with pytest.raises(InputError) as caught:
        load_state(path, SETTING)
    assert str(path) in str(caught.value)


@given(end=st.floats(0.0, 0.999))
@settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_a_file_cut_short_is_refused(saved, tmp_path, end):
    path = tmp_path / "state.json"
    path.write_text(saved[: int(end * len(saved))])
    refused(path)


def places(value, path=()):
    """Every place in a document."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield (*path, key)
            yield from places(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield (*path, index)
            yield from places(item, (*path, index))


JSON_VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.integers(10**25, 10**30), st.text(max_size=5),
    st.floats(), st.sampled_from([[], {}, [[]], [[1.0]], {"x": []}, [None], "NaN", 1e308]),
)  # fmt: skip


@given(pick=st.data())
@settings(
    deadline=None, max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_a_changed_file_is_refused(saved, tmp_path, pick):
    """A value changed, an entry left out or doubled, anywhere."""
    document = json.loads(saved)
    spots = list(places(document))
    spot = pick.draw(st.sampled_from(spots))
    holder = document
    for key in spot[:-1]:
        holder = holder[key]
    before = copy.deepcopy(holder)
    action = pick.draw(st.sampled_from(["change", "drop", "double"]))
    if action == "drop":
        del holder[spot[-1]]
    elif action == "double" and isinstance(holder, list):
        holder.append(holder[spot[-1]])
    else:
        holder[spot[-1]] = pick.draw(JSON_VALUES)
    path = tmp_path / "state.json"
    path.write_text(json.dumps(document))
    if json.dumps(holder) == json.dumps(before):
        return
    refused(path)


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "null", "{}", '{"schema": "stcal.filter/2"}', '{"schema": "stcal.filter/1"}',
        '{"schema": "stcal.filter/1", "setting": {}, "filters": {}, "sha256": ""}',
        '{"schema": "stcal.filter/1", "setting": NaN, "filters": {}, "sha256": ""}',
        '{"schema": "stcal.filter/1", "setting": ' + "[" * 400 + "]" * 400 + "}",
        '{"schema": "stcal.filter/1", "setting": ' + "[" * 900 + "]" * 900 + "}",
        '{"schema": "stcal.filter/1", "setting": ' + "[" * 100000 + "]" * 100000 + "}",
    ],
)  # fmt: skip
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / "state.json"
    path.write_text(text)
    refused(path)


def test_a_missing_file_is_refused(tmp_path):
    refused(tmp_path / "none.json")
