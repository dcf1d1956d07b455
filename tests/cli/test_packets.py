"""``stcal packets``, and packets through simulate and ingest."""

from __future__ import annotations

import json

import numpy as np
import space_packet_parser as spp
from conftest import ROOT, simulation

from stcal.cli import main
from stcal.simulate.files import write_packets, write_simulation
from stcal.telemetry.packet_describe import describe
from stcal.telemetry.packet_layout import load_layout
from stcal.telemetry.store import Store

EXAMPLE = ROOT / "configs" / "packets" / "st16.toml"
CONFIG = ROOT / "configs" / "st16.toml"
SAMPLE = ROOT / "sample_telemetry"


def call(capsys, *arguments):
    code = main(list(map(str, arguments)))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_describe(capsys):
    code, out, _ = call(capsys, "packets", "describe", EXAMPLE, "--json")
    assert code == 0
    assert json.loads(out) == json.loads(json.dumps(describe(load_layout(EXAMPLE))))
    code, out, _ = call(capsys, "packets", "describe", EXAMPLE)
    assert code == 0
    assert "TAI since 1958-01-01T00:00:00" in out
    assert "matches_0" in out


def test_xtce(tmp_path, capsys):
    path = tmp_path / "st16.xml"
    code, out, _ = call(capsys, "packets", "xtce", EXAMPLE, "--out", path, "--json")
    assert code == 0
    assert json.loads(out)["containers"] == 5
    assert set(spp.load_xtce(path).containers) >= {"Frame", "stars_0_entry", "matches_0_entry"}
    code, _, err = call(capsys, "packets", "xtce", EXAMPLE, "--out", path, "--lists", "expanded")
    assert code == 3
    assert "35937 combinations" in err


def test_a_bad_layout_is_bad_configuration(tmp_path, capsys):
    path = tmp_path / "bad.toml"
    path.write_text('schema = "stcal.packet-layout/1"\n')
    for arguments in (
        ("packets", "describe", path),
        ("ingest", SAMPLE, "--store", tmp_path / "s", "--config", CONFIG, "--packets", path),
    ):
        code, _, err = call(capsys, *arguments)
        assert code == 3
        assert "apids: Field required" in err


def test_the_same_simulation_as_packets_and_as_csv(tmp_path, capsys):
    made = simulation(2, 1, 20)
    write_simulation(made, tmp_path, truth_columns=False)
    write_packets(made, load_layout(EXAMPLE), tmp_path)
    frames = {}
    for name in ("ccsds", "csv.gz"):
        source, store = tmp_path / f"ST16-2.calibration.{name}", tmp_path / name
        arguments = ("--store", store, "--config", CONFIG, "--packets", EXAMPLE, "--json")
        assert call(capsys, "ingest", source, *arguments)[0] == 0
        frames[name] = Store.open(store).read_frames("ST16-2")
    packets, text = frames["ccsds"], frames["csv.gz"]
    assert packets.n_frames == text.n_frames > 10
    for name in ("frame_id", "best_exposure", "eclipse", "intrusion", "star_offsets", "star_id"):
        np.testing.assert_array_equal(getattr(packets, name), getattr(text, name))
    assert np.abs(packets.t_tai_ns - text.t_tai_ns).max() <= 60
    # Half a step of each, and the digits of the text.
    steps = {"q_si": 2e-9, "rate_deg_s": 1e-7, "temperature_c": 6e-3, "pos_km": 6e-5}
    steps |= {"vel_km_s": 6e-7, "row_px": 2e-3, "col_px": 2e-3}
    for name, step in steps.items():
        np.testing.assert_allclose(getattr(packets, name), getattr(text, name), rtol=0, atol=step)
    np.testing.assert_allclose(packets.intensity, text.intensity, rtol=1e-6)


def test_the_sample_downlink(tmp_path, capsys):
    """A gap of eight packets, one that came twice, and damage in a part of its own."""
    arguments = ("--store", tmp_path / "store", "--config", CONFIG, "--packets", EXAMPLE)
    code, out, _ = call(capsys, "ingest", SAMPLE / "ST16-2.downlink.ccsds", *arguments, "--json")
    assert code == 0
    (source,) = json.loads(out)["sources"]
    (counts,) = source["packets"]["apids"]
    assert (counts["packets"], counts["duplicates"], counts["gaps"], counts["lost"]) == (
        143,
        1,
        1,
        8,
    )
    code, out, _ = call(capsys, "ingest", SAMPLE / "ST16-2.damaged.ccsds", *arguments)
    assert "packet_crc" in out
    assert "packet_sync" in out
    assert "Lost" in out


def test_simulate_refuses_a_bad_layout_before_it_works(tmp_path, capsys):
    scenario = ROOT / "configs" / "scenarios" / "st16-2.toml"
    out = tmp_path / "out"
    code, _, err = call(
        capsys, "simulate", scenario, "--out", out, "--packets", tmp_path / "none.toml"
    )
    assert code == 3
    assert "none.toml: cannot be read" in err
    assert not list(out.glob("*"))
