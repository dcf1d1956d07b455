"""``stcal fit --sequential``: files, going on from a state, refusals, and what makes no sense."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from conftest import ROOT

from stcal.calibration import load
from stcal.cli import main

SAMPLE = ROOT / "sample_telemetry"
SENSOR = "ST16-4"
INITIAL = SAMPLE / f"{SENSOR}.initial.json"
MIDDLE = "2014-09-03T15:00:00Z"


def run(capsys, *arguments):
    """Exit code, standard output and standard error of a command."""
    code = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def fit_arguments(store, out, *more, initial=INITIAL):
    return ["fit", "--store", store, "--sensor", SENSOR, "--initial", initial, "--out", out, *more]


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("store") / "store"
    code = main(
        ["ingest", str(SAMPLE / f"{SENSOR}.calibration.csv.gz"), "--store", str(folder),
         "--config", str(ROOT / "configs" / "st16.toml"), "--json"]
    )  # fmt: skip
    assert code == 0
    return folder


@pytest.fixture(scope="module")
def whole(store, tmp_path_factory) -> Path:
    """One run over all frames, with everything that has a file of its own."""
    out = tmp_path_factory.mktemp("whole")
    arguments = fit_arguments(
        store, out, "--sequential", "sqrf", "--process-noise", "f_m=0.1", "--temperature", "f_m",
        "--json",
    )  # fmt: skip
    assert main([str(a) for a in arguments]) == 0
    return out


def test_a_fit_writes_its_files(whole):
    names = {path.name for path in whole.iterdir()}
    assert names == {
        "calibration.json", "fit.json", "report.html", "state.json", "history.parquet",
        "thermal-history.parquet",
    }  # fmt: skip
    document = json.loads((whole / "fit.json").read_text())
    found = load(whole / "calibration.json")
    assert [p["fitted"] for p in document["parameters"]] == found.camera.parameters.tolist()
    assert found.serial == load(INITIAL).serial + 1
    described = document["sequential"]
    assert described["variant"]["method"] == "sqrf"
    assert described["variant"]["process_noise"] == {"f_m": 0.1}
    assert described["temperature"]["chosen"] is False
    truth = load(SAMPLE / "truth" / f"{SENSOR}.json").camera.parameters
    sd = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.camera.parameters - truth) < 4.5 * sd).all()
    history = pq.read_table(whole / "history.parquet")
    assert history.num_rows == described["frames"] == 400
    assert history["f_m"][-1].as_py() == found.camera.value("f_m")
    state = json.loads((whole / "state.json").read_text())
    assert set(state["filters"]) == {"constant", "thermal"}
    assert state["filters"]["constant"]["last_frame_id"] == history["frame_id"][-1].as_py()
    assert "<html" in (whole / "report.html").read_text()


def test_json_is_the_document(store, capsys, tmp_path):
    code, out, err = run(
        capsys,
        *fit_arguments(
            store, tmp_path, "--sequential", "ukf", "--to", MIDDLE, "--json", "--workers", 2
        ),
    )
    assert code == 0
    assert err == ""
    assert json.loads(out) == json.loads((tmp_path / "fit.json").read_text())


def test_tables_for_people(store, capsys, tmp_path):
    code, out, _ = run(
        capsys,
        *fit_arguments(store, tmp_path, "--sequential", "ekf", "--no-rematch", "--to", MIDDLE),
    )
    assert code == 0
    assert "Fit accepted" in out
    assert max(map(len, out.splitlines())) <= 80


def test_a_run_in_two_parts_ends_as_one(store, whole, capsys, tmp_path):
    """Bitwise: calibration, state and histories; the second part goes on in its own folder."""
    options = (
        "--sequential", "sqrf", "--process-noise", "f_m=0.1", "--temperature", "f_m", "--json",
    )  # fmt: skip
    first, second = tmp_path / "first", tmp_path / "second"
    code, *_ = run(capsys, *fit_arguments(store, first, *options, "--to", MIDDLE))
    assert code in (0, 4)
    seen = pq.read_table(first / "history.parquet").num_rows
    assert 0 < seen < 400
    code, *_ = run(capsys, *fit_arguments(store, second, *options, "--state", first / "state.json"))
    assert code == 0
    for name in ("state.json", "history.parquet", "thermal-history.parquet"):
        assert (second / name).read_bytes() == (whole / name).read_bytes(), name
    one, other = (load(folder / "calibration.json") for folder in (whole, second))
    assert np.array_equal(one.camera.parameters, other.camera.parameters)
    assert np.array_equal(one.covariance, other.covariance)
    assert np.array_equal(one.c_sd, other.c_sd)


def test_going_on_may_replace_its_own_files(store, half, capsys, tmp_path):
    shutil.copytree(half, tmp_path, dirs_exist_ok=True)
    code, out, _ = run(
        capsys,
        *fit_arguments(
            store, tmp_path, "--sequential", "sqrf", "--json", "--state", tmp_path / "state.json"
        ),
    )
    assert code == 0
    assert json.loads(out)["sequential"]["frames"] == 400
    assert pq.read_table(tmp_path / "history.parquet").num_rows == 400


@pytest.fixture(scope="module")
def half(store, tmp_path_factory):
    out = tmp_path_factory.mktemp("half")
    arguments = fit_arguments(store, out, "--sequential", "sqrf", "--to", MIDDLE, "--json")
    assert main([str(a) for a in arguments]) in (0, 4)
    return out


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--sequential", "ekf"], "method"),
        (["--sequential", "sqrf", "--process-noise", "0.2"], "process_noise"),
        (["--sequential", "sqrf", "--precision", "single"], "precision"),
        (["--sequential", "sqrf", "--no-rematch"], "rematch"),
        (["--sequential", "sqrf", "--no-shadow"], "shadow"),
        (["--sequential", "sqrf", "--parameters", "f_m,g_y"], "parameters"),
        (["--sequential", "sqrf", "--matches", "guided"], "matches"),
        (["--sequential", "sqrf", "--temperature", "f_m"], "temperature"),
    ],
)
def test_a_state_of_another_variant_is_refused(store, half, capsys, tmp_path, options, named):
    code, out, err = run(
        capsys, *fit_arguments(store, tmp_path, *options, "--state", half / "state.json")
    )
    assert code == 3
    assert "state.json: was made with" in err
    assert named in err
    assert "Traceback" not in err
    assert out == ""
    assert not list(tmp_path.iterdir())


def test_a_state_of_another_calibration_is_refused(store, half, capsys, tmp_path):
    document = json.loads(INITIAL.read_text())
    document["camera"]["parameters"]["f_m"] += 1e-6
    other = tmp_path / "other.json"
    other.write_text(json.dumps(document))
    code, _, err = run(
        capsys,
        *fit_arguments(
            store, tmp_path / "out", "--sequential", "sqrf", "--state", half / "state.json",
            initial=other,
        ),
    )  # fmt: skip
    assert code == 3
    assert "parent_sha256" in err


def spoil(half, folder, name, change):
    """A copy of a run's folder with one file changed."""
    copy = folder / "copy"
    shutil.copytree(half, copy)
    change(copy / name)
    return copy


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("state.json", lambda path: path.write_text("{}")),
        ("state.json", lambda path: path.write_bytes(path.read_bytes()[:5000])),
        ("state.json", lambda path: path.unlink()),
        ("history.parquet", lambda path: path.write_bytes(path.read_bytes()[:5000])),
        ("history.parquet", lambda path: path.unlink()),
        ("history.parquet", lambda path: pq.write_table(pq.read_table(path).slice(0, 20), path)),
    ],
)
def test_damaged_files_to_go_on_from_are_bad_input(store, half, capsys, tmp_path, name, change):
    """The last one is of a shorter run than the state's."""
    copy = spoil(half, tmp_path, name, change)
    code, out, err = run(
        capsys,
        *fit_arguments(
            store, tmp_path / "out", "--sequential", "sqrf", "--state", copy / "state.json"
        ),
    )
    assert code == 3
    assert str(copy / name) in err
    assert "Traceback" not in err
    assert out == ""


def test_a_refused_fit_leaves_no_calibration(store, whole, capsys, tmp_path):
    """Nor the one of an earlier run; history and state are there to look at."""
    shutil.copy(whole / "calibration.json", tmp_path / "calibration.json")
    code, out, err = run(
        capsys,
        *fit_arguments(
            store, tmp_path, "--sequential", "sqrf", "--to", "2014-09-03T11:40:00Z", "--json"
        ),
    )
    assert code == 4
    document = json.loads(out)
    assert document["exit_code"] == 4
    assert not document["verdict"]["accepted"]
    assert document["verdict"]["reasons"][0] in err
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"fit.json", "report.html", "history.parquet", "state.json"}


def test_a_filter_that_breaks_numerically_ends_in_a_refusal(store, capsys, tmp_path):
    """The plain filter in single precision, from a wide prior: told, written down, refused."""
    text = (ROOT / "configs" / "st16.toml").read_text()
    wide = tmp_path / "wide.toml"
    changed = re.sub(r"initial_sd_sigma = \S+", "initial_sd_sigma = 100.0", text)
    assert changed != text
    wide.write_text(changed)
    code, out, err = run(
        capsys,
        *fit_arguments(
            store, tmp_path / "out", "--sequential", "ekf", "--precision", "single", "--config",
            wide, "--json",
        ),
    )  # fmt: skip
    assert code == 4
    assert "numerical at frame" in err
    document = json.loads(out)
    assert {e["event"] for e in document["sequential"]["events"]} >= {"numerical"}
    assert document["sequential"]["innovations"]["per_arc"] > 0
    assert json.loads((tmp_path / "out" / "state.json").read_text())["filters"]


SEQUENTIAL = ["--sequential", "sqrf"]
NONSENSE = [
    ([], "--batch or --sequential"),
    (["--batch", *SEQUENTIAL], "--batch or --sequential"),
    (["--batch", "--residual", "chords"], "chords"),
    (["--batch", "--groups", "1"], "belong to --residual singular-values"),
    ([*SEQUENTIAL, "--residual", "cosine", "--values", "2"], "belong to --residual singular"),
    (["--batch", "--residual", "singular-values", "--groups", "5"], "groups 5"),
    (["--batch", "--residual", "singular-values", "--values", "2,4"], "values"),
    (["--batch", "--residual", "singular-values", "--values", "two"], "'two' is not a list"),
    (["--sequential", "kalman"], "kalman"),
    (["--batch", "--no-rematch"], "belong to --sequential"),
    (["--batch", "--process-noise", "0.1"], "belong to --sequential"),
    (["--batch", "--temperature", "f_m"], "belong to --sequential"),
    (["--batch", "--precision", "single"], "belong to --sequential"),
    (["--batch", "--no-shadow"], "belong to --sequential"),
    (["--batch", "--state", "state.json"], "belong to --sequential"),
    ([*SEQUENTIAL, "--precision", "half"], "half"),
    (["--sequential", "smoother", "--precision", "single"], "no single precision"),
    (["--sequential", "smoother", "--process-noise", "0.1"], "no process noise"),
    (["--sequential", "smoother", "--state", "state.json"], "no --state"),
    ([*SEQUENTIAL, "--matches", "telemetry"], "--no-rematch"),
    ([*SEQUENTIAL, "--process-noise", "much"], "'much' is not a number"),
    ([*SEQUENTIAL, "--process-noise", "-1"], "'-1' is not a number"),
    ([*SEQUENTIAL, "--process-noise", "nan"], "'nan' is not a number"),
    ([*SEQUENTIAL, "--process-noise", "inf"], "'inf' is not a number"),
    ([*SEQUENTIAL, "--process-noise", ""], "is not a number"),
    ([*SEQUENTIAL, "--process-noise", "f_m="], "is not a number"),
    ([*SEQUENTIAL, "--process-noise", "zoom=1"], "'zoom' is not one of f_m"),
    ([*SEQUENTIAL, "--process-noise", "f_m=1,f_m=2"], "f_m"),
    ([*SEQUENTIAL, "--process-noise", "f_m=1", "--parameters", "g_y"], "f_m"),
    ([*SEQUENTIAL, "--parameters", "f_m,zoom"], "zoom"),
    ([*SEQUENTIAL, "--parameters", "f_m,f_m"], "once"),
    ([*SEQUENTIAL, "--parameters", ""], "parameter"),
    (["--batch", "--parameters", "f_m,zoom"], "zoom"),
    (["--batch", "--parameters", "f_m,f_m"], "once"),
    ([*SEQUENTIAL, "--temperature", "warmth"], "warmth"),
    ([*SEQUENTIAL, "--temperature", "f_m,f_m"], "once"),
    ([*SEQUENTIAL, "--temperature", "f_m", "--parameters", "g_y"], "f_m"),
]


@pytest.mark.parametrize(("options", "message"), NONSENSE)
def test_options_that_make_no_sense_end_in_exit_2(store, capsys, tmp_path, options, message):
    code, out, err = run(capsys, *fit_arguments(store, tmp_path, *options))
    assert code == 2
    assert message in err
    assert "Traceback" not in err
    assert out == ""
    assert not list(tmp_path.iterdir())


def test_an_error_is_told_in_json_too(store, capsys, tmp_path):
    code, out, _ = run(capsys, *fit_arguments(store, tmp_path, "--batch", "--no-shadow", "--json"))
    assert code == 2
    assert json.loads(out)["exit_code"] == 2
    assert "--sequential" in json.loads(out)["error"]
