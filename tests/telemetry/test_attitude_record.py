"""The record of body attitudes: what it may look like, and what is said of one that is wrong."""

import gzip

import numpy as np
import pytest

from stcal.errors import InputError
from stcal.telemetry.attitudes import read_attitudes
from stcal.times import parse_utc

HEADER = "time_utc,q_x,q_y,q_z,q_w"
TIMES = ("2026-01-05T12:00:00.000Z", "2026-01-05T12:00:01.000Z")
ROWS = [f"{TIMES[0]},0.6,0,0,0.8", f"{TIMES[1]},0,0,-0.6,0.8"]


def record(tmp_path, *lines, name="body.csv"):
    path = tmp_path / name
    content = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    return path


@pytest.mark.parametrize("name", ["body.csv", "body.csv.gz"])
def test_a_record_is_read_in_time_order(tmp_path, name):
    found = read_attitudes(record(tmp_path, HEADER, ROWS[1], ROWS[0], name=name))
    assert found.t_tai_ns.tolist() == [parse_utc(t) for t in TIMES]
    np.testing.assert_allclose(found.q_bi, [[0.6, 0, 0, 0.8], [0, 0, -0.6, 0.8]])
    assert not found.covariance.any()
    assert found.source["file"] == name
    assert len(found.source["sha256"]) == 64


def test_other_columns_orders_and_line_ends_do_not_matter(tmp_path):
    plain = read_attitudes(record(tmp_path, HEADER, *ROWS))
    lines = ["note, q_w ,q_x,q_y,q_z,time_utc"]
    for row in ROWS:
        time, x, y, z, w = row.split(",")
        lines.append(f'"slew, then hold",{w}, {x} ,{y},{z},{time}')
    path = tmp_path / "other.csv"
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode() + b"\r\n\r\n")
    found = read_attitudes(path)
    assert np.array_equal(found.t_tai_ns, plain.t_tai_ns)
    assert np.array_equal(found.q_bi, plain.q_bi)


def test_quaternions_are_made_unit_and_gaps_left_out(tmp_path):
    found = read_attitudes(record(tmp_path, HEADER, f"{TIMES[0]},,,,", f"{TIMES[1]},0,0,0,1.0005"))
    assert found.t_tai_ns.tolist() == [parse_utc(TIMES[1])]
    assert found.q_bi.tolist() == [[0.0, 0.0, 0.0, 1.0]]


def test_the_noise_is_one_for_all_axes_or_one_for_each(tmp_path):
    one = read_attitudes(record(tmp_path, f"{HEADER},sd_urad", ROWS[1] + ",20", ROWS[0] + ",5"))
    np.testing.assert_allclose(one.covariance[1], np.eye(3) * 4e-10)
    header = f"{HEADER},sd_x_urad,sd_y_urad,sd_z_urad"
    each = read_attitudes(record(tmp_path, header, ROWS[0] + ",5,6,70"))
    np.testing.assert_allclose(each.covariance[0], np.diag([25e-12, 36e-12, 4900e-12]))


LATER = "2026-01-05T12:00:02.000Z"
WRONG = [
    ([HEADER], "no row has an attitude"),
    ([HEADER, f"{TIMES[0]},,,,"], "no row has an attitude"),
    (["time_utc,q_x,q_w", "x,0,1"], "row 1: missing column(s): q_y, q_z"),
    ([f"{HEADER},q_x", f"{ROWS[0]},0"], "row 1: column(s) given more than once: q_x"),
    ([f"{HEADER},sd_x_urad", f"{ROWS[0]},5"], "row 1: the noise is either sd_urad or all of"),
    ([HEADER, *ROWS, f"{LATER},0,0,0"], "row 4: 4 fields, the header has 5"),
    ([HEADER, ROWS[0] + ",7"], "row 2: 6 fields, the header has 5"),
    ([HEADER, ROWS[0], "2026-01-05 12:00:01,0,0,0,1"], "row 3: time_utc is not"),
    ([HEADER, ROWS[0], "", ROWS[1]], "row 3: "),
    ([HEADER, *ROWS, f"{LATER},0,0,zero,1"], "row 4: q_z is not a number"),
    ([HEADER, *ROWS, f"{LATER},0,0,nan,1"], "row 4: q_z is not a number"),
    ([HEADER, ROWS[0], f"{LATER},0,0,,1"], "row 3: the quaternion is not whole"),
    ([HEADER, ROWS[0], f"{LATER},0,0,0,1.1"], "row 3: the quaternion is not of unit norm (1.1)"),
    ([HEADER, ROWS[0], f"{LATER},0,0,0,0", f"{LATER},0,0,0,0"], "and 1 more such rows"),
    ([f"{HEADER},sd_urad", ROWS[0] + ",5", ROWS[1] + ","], "row 3: sd_urad is missing"),
    ([f"{HEADER},sd_urad", ROWS[0] + ",-5"], "row 2: sd_urad is missing, negative"),
    ([HEADER, ROWS[1], ROWS[0], f"{TIMES[1]},0,0,0,1"], "row 4: the time of row 2 again"),
    ([f"{HEADER},note", ROWS[0] + ',"a', ROWS[1] + ",b"], "a quoted field goes over"),
]


@pytest.mark.parametrize(("lines", "message"), WRONG)
def test_a_wrong_record_is_refused_with_its_row(tmp_path, lines, message):
    path = record(tmp_path, *lines)
    with pytest.raises(InputError) as caught:
        read_attitudes(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)


def test_damaged_files_are_refused_by_name(tmp_path):
    whole = record(tmp_path, HEADER, *ROWS, name="body.csv.gz").read_bytes()
    odd = {
        "missing.csv": None,
        "empty.csv": b"",
        "cut.csv.gz": whole[:-9],
        "latin.csv": f"{HEADER}\n{ROWS[0]}\n".encode() + b"\xe9,0,0,0,1\n",
    }
    for name, content in odd.items():
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            read_attitudes(tmp_path / name)
    with pytest.raises(InputError, match="row 3: is not UTF-8"):
        read_attitudes(tmp_path / "latin.csv")
