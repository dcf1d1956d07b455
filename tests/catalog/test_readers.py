from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from catalog_official_files import hipparcos_line, supplement_line, tycho2_line, write

from stcal.catalog import fixed_width
from stcal.catalog.identifiers import decode
from stcal.catalog.readers import SourceStars, read_hipparcos, read_supplement, read_tycho2
from stcal.catalog.sphere import unit_vector
from stcal.constants import DEG, MAS
from stcal.errors import InputError

MAIN = [
    tycho2_line((1, 8, 1), 2.31750494, 2.23184345, pm=(-16.3, -9.0), bt=7.146, vt=6.670, hip=7),
    tycho2_line((1, 13, 1), 1.12558209, 2.26739400, pm=(27.7, -0.5), bt=None, vt=7.010),
    tycho2_line(
        *((1, 16, 2), None, None), pm=None, bt=6.0, vt=5.5, pflag="X", observed=(1.05, -1.89)
    ),
    tycho2_line((9537, 12121, 3), 359.9, -89.5, bt=7.5, vt=7.4, pflag="P", ccdm="AB"),
    tycho2_line((9, 9, 1), 9.0, 9.0, bt=8.0, vt=None, posflg="D", hip=118218, ccdm="A"),
    tycho2_line((9, 10, 1), 9.0, 9.1, bt=None, vt=None),
    tycho2_line((9, 11, 1), 9.0, 9.2, bt=12.0, vt=11.5),
]


def degrees(ra: float, dec: float) -> np.ndarray:
    return unit_vector(np.array([ra]) * DEG, np.array([dec]) * DEG)[0]


def test_tycho2(tmp_path: Path) -> None:
    stars = read_tycho2(write(tmp_path / "tyc2.dat", MAIN), faintest=9.0)
    assert decode(stars.tycho_id).tolist() == [
        *("TYC 1-8-1", "TYC 1-13-1", "TYC 1-16-2", "TYC 9537-12121-3", "TYC 9-9-1")
    ]
    assert stars.hip.tolist() == [7, 0, 0, 0, 118218]
    np.testing.assert_allclose(stars.direction[0], degrees(2.31750494, 2.23184345), atol=1e-15)
    # The satellite's position where there is no mean one, at the mean of its two epochs.
    np.testing.assert_allclose(stars.direction[2], degrees(1.05, -1.89), atol=1e-15)
    np.testing.assert_allclose(stars.epoch, [2000, 2000, 1991.5, 2000, 2000], atol=1e-9)
    assert stars.has_motion.tolist() == [True, True, False, True, True]
    assert np.linalg.norm(stars.motion[0]) / MAS == pytest.approx(np.hypot(16.3, 9.0))
    assert not stars.motion[2].any()
    north = np.gradient(np.array([degrees(2.31750494, d) for d in (2.2317, 2.2319)]), axis=0)[0]
    assert np.sign(stars.motion[0] @ north) == -1.0
    assert stars.magnitude[0] == pytest.approx(6.670 - 0.090 * 0.476, abs=1e-9)
    assert stars.colour[0] == pytest.approx(0.850 * 0.476, abs=1e-9)
    assert stars.magnitude[1] == pytest.approx(7.010 - 0.0576, abs=1e-9)
    assert np.isnan(stars.colour[1])
    assert stars.magnitude[4] == pytest.approx(8.0 - 0.64 - 0.0576, abs=1e-9)
    assert stars.multiple.tolist() == [False, False, False, True, True]
    assert stars.merged.tolist() == [False, False, False, True, False]
    assert np.isnan(stars.parallax).all()


def test_supplement(tmp_path: Path) -> None:
    rows = [
        supplement_line((2, 1155, 1), 4.0, 1.0, pm=(11.5, -3.2), bt=5.0, vt=4.5, hip=99, ccdm="B"),
        supplement_line((2, 1156, 2), 4.1, 1.1, pm=None, vt=6.0, mflag="H"),
        supplement_line((2, 1157, 1), 4.2, 1.2, pm=None, bt=7.0, mflag="B"),
        supplement_line((2, 1158, 4), 4.3, 1.3, pm=None, vt=7.5, mflag="V"),
    ]
    stars = read_supplement(write(tmp_path / "suppl_1.dat", rows))
    assert stars.hip.tolist() == [99, 0, 0, 0]
    assert (stars.epoch == 1991.25).all()
    assert stars.multiple.tolist() == [True, False, False, False]
    assert stars.has_motion.tolist() == [True, False, False, False]
    np.testing.assert_allclose(stars.direction[1], degrees(4.1, 1.1), atol=1e-15)
    # Hp is brighter than V by 0.12 at B-V 0.5; BT and VT go by a typical colour.
    np.testing.assert_allclose(stars.magnitude, [4.455, 5.87, 6.30, 7.44], atol=0.01)
    assert np.isnan(stars.colour[1:]).all()


def test_hipparcos(tmp_path: Path) -> None:
    rows = [
        hipparcos_line(
            *(71683, 3.8380152931, -1.0617542067), pm=(-3679.25, 473.67), parallax=754.81,
            hp=0.1373, colour=0.71, components=2,
        ),
        hipparcos_line(
            120404, 6.2831853072, 1.5, pm=(1.5, -2.5), parallax=-3.21, hp=8.0, colour=None
        ),
    ]  # fmt: skip
    stars = read_hipparcos(write(tmp_path / "hip2.dat", rows))
    assert stars.hip.tolist() == [71683, 120404]
    assert not stars.tycho_id.any()
    place = unit_vector(np.array([3.8380152931]), np.array([-1.0617542067]))[0]
    np.testing.assert_allclose(stars.direction[0], place, atol=1e-15)
    np.testing.assert_allclose(stars.parallax / MAS, [754.81, -3.21])
    assert np.linalg.norm(stars.motion[0]) / MAS == pytest.approx(np.hypot(3679.25, 473.67))
    assert stars.colour[0] == pytest.approx(0.71)
    assert np.isnan(stars.colour[1])
    # Alpha Centauri A is V 0.01.
    assert stars.magnitude[0] == pytest.approx(0.0, abs=0.02)
    assert stars.multiple.tolist() == [True, False]


def same(a: SourceStars, b: SourceStars) -> bool:
    return all(
        np.array_equal(getattr(a, n), getattr(b, n), equal_nan=n in ("magnitude", "colour"))
        for n in ("tycho_id", "hip", "direction", "motion", "magnitude", "colour", "multiple")
    )


def test_line_ends_and_gzip_do_not_matter(tmp_path: Path) -> None:
    plain = read_tycho2(write(tmp_path / "a", MAIN))
    assert len(plain.hip) == 6
    assert same(plain, read_tycho2(write(tmp_path / "b", MAIN, end="\r\n")))
    packed = tmp_path / "c.gz"
    packed.write_bytes(gzip.compress((tmp_path / "a").read_bytes()))
    assert same(plain, read_tycho2(packed))
    for name, tail in (("a", 1), ("b", 2), ("b", 1)):
        open_end = tmp_path / f"{name}{tail}"
        open_end.write_bytes((tmp_path / name).read_bytes()[:-tail])
        assert same(plain, read_tycho2(open_end))


def test_rows_are_counted_across_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "tyc2.dat", MAIN * 30)
    whole = read_tycho2(path)
    monkeypatch.setattr(fixed_width, "_CHUNK_BYTES", 1000)
    assert same(whole, read_tycho2(path))
    broken = MAIN * 30
    broken[123] = broken[123][:20] + "x" + broken[123][21:]
    with pytest.raises(InputError, match="row 124"):
        read_tycho2(write(path, broken))


def put(byte: int, text: str) -> Callable[[list[str]], list[str]]:
    """Overwrite bytes, from 1, of the third row."""

    def change(rows: list[str]) -> list[str]:
        rows[2] = rows[2][: byte - 1] + text + rows[2][byte - 1 + len(text) :]
        return rows

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (put(153, "    x.050000"), r"row 3: RAdeg \(bytes 153-164\) is not a number: 'x.050000'"),
        (put(153, "361.05000000"), r"row 3: RAdeg \(bytes 153-164\) is outside 0 to 360"),
        (put(166, " 91.00000000"), r"row 3: DEdeg \(bytes 166-177\) is outside -90 to 90"),
        (put(166, "         nan"), r"row 3: DEdeg \(bytes 166-177\) is outside"),
        (put(153, " " * 12), r"row 3: RAdeg \(bytes 153-164\) is blank"),
        (put(28, " "), r"row 3: no '\|' at byte 28"),
        (put(14, "Q"), r"row 3: pflag \(byte 14\) is not one of"),
        (put(14, " "), r"row 3: pflag and mean position .* disagree"),
        (put(6, "00016.5"), r"row 3: "),
        (put(143, "   1.5"), r"row 3: HIP \(bytes 143-148\) is not an integer"),
        (put(143, "200000"), r"row 3: HIP \(bytes 143-148\) is outside 1 to 120404"),
        (put(124, "99.999"), r"row 3: VTmag \(bytes 124-129\) is outside"),
        (lambda r: [*r[:2], r[2][:-1], *r[3:]], r"row 3: not 206 characters long"),
        (lambda r: [*r[:2], r[2] + " ", *r[3:]], r"row 3: not 206 characters long"),
        (lambda r: [*r[:2], "", *r[3:]], r"row 3: not 206 characters long"),
        (lambda r: [*r[:2], *r[3:], r[2][:100]], r"row 7: "),
        (lambda r: [r[0][:-3], *r[1:]], r"row 1: 203 characters, 206 expected"),
        (lambda r: [supplement_line((2, 1, 1), 4.0, 1.0, pm=None, vt=7.0)], r"row 1: 122 char"),
    ],
)
def test_a_bad_row_is_named(
    change: Callable[[list[str]], list[str]], reason: str, tmp_path: Path
) -> None:
    path = write(tmp_path / "tyc2.dat", change(list(MAIN)))
    with pytest.raises(InputError, match=r"tyc2\.dat: " + reason):
        read_tycho2(path)


def test_a_file_cut_short_is_named(tmp_path: Path) -> None:
    path = write(tmp_path / "tyc2.dat", MAIN)
    content = path.read_bytes()
    path.write_bytes(content[: 5 * 207 + 80])
    with pytest.raises(InputError, match=r"tyc2\.dat: row 6: cut short after 80 of 207 bytes"):
        read_tycho2(path)
    path.write_bytes(content[:100])
    with pytest.raises(InputError, match=r"tyc2\.dat: row 1: 100 characters, 206 expected"):
        read_tycho2(path)
    path.write_bytes(gzip.compress(content)[:-20])
    with pytest.raises(InputError, match=r"tyc2\.dat: gzip damaged or cut short"):
        read_tycho2(path)
    path.write_bytes(b"")
    with pytest.raises(InputError, match=r"tyc2\.dat: the file is empty"):
        read_tycho2(path)
    with pytest.raises(InputError, match=r"nowhere\.dat: cannot be read: No such file"):
        read_hipparcos(tmp_path / "nowhere.dat")


def test_the_other_files_name_their_rows_too(tmp_path: Path) -> None:
    rows = [supplement_line((2, 1, 1), 4.0, 1.0, pm=None, vt=7.0)] * 2
    rows[1] = rows[1].replace("|T|", "|?|", 1).replace("1.00000000", "1.0000000o")
    with pytest.raises(InputError, match=r"suppl_1\.dat: row 2: flag"):
        read_supplement(write(tmp_path / "suppl_1.dat", rows))
    hip = hipparcos_line(5, 1.0, 1.0, pm=(0, 0), parallax=1.0, hp=7.0, colour=0.5)
    with pytest.raises(InputError, match=r"hip2\.dat: row 2: Hpmag .* is blank"):
        read_hipparcos(write(tmp_path / "hip2.dat", [hip, hip.replace(" 7.0000", " " * 7)]))


def test_a_cut_gzip_names_its_last_good_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(1)
    magnitudes = random.uniform(3.0, 9.0, 3000).round(3)
    rows = [tycho2_line((1, k + 1, 1), 1.0 + k / 17, 2.0, bt=9.5, vt=v)
            for k, v in enumerate(magnitudes)]  # fmt: skip
    path = tmp_path / "tyc2.dat.gz"
    packed = gzip.compress("".join(row + "\n" for row in rows).encode())
    path.write_bytes(packed[: len(packed) // 2])
    unpacked = zlib.decompressobj(31).decompress(path.read_bytes())
    good = unpacked.count(b"\n")
    assert 500 < good < 2900
    for block in (fixed_width._CHUNK_BYTES, 10_000):
        monkeypatch.setattr(fixed_width, "_CHUNK_BYTES", block)
        with pytest.raises(InputError, match=f"tyc2.dat.gz: gzip .* after row {good}:"):
            read_tycho2(path)
