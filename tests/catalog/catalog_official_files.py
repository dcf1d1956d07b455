"""Writers of the official fixed-width records, from the CDS byte-by-byte descriptions.

Written apart from the readers: each field is put at its byte numbers on a line of blanks.
"""

from __future__ import annotations

from pathlib import Path


def line(length: int, fields: dict[tuple[int, int], str], bars: str = "") -> str:
    """Put texts at (first, last) byte numbers, from 1, right-aligned, and bars at given bytes."""
    row = [" "] * length
    for (first, last), text in fields.items():
        width = last - first + 1
        if len(text) > width:
            raise ValueError(f"{text!r} does not fit bytes {first}-{last}")
        row[first - 1 : last] = text.rjust(width)
    for byte in bars.split():
        row[int(byte) - 1] = "|"
    return "".join(row)


def optional(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def tycho2_line(
    tyc: tuple[int, int, int],
    ra: float | None,
    dec: float | None,
    *,
    pm: tuple[float, float] | None = (0.0, 0.0),
    bt: float | None,
    vt: float | None,
    hip: int | None = None,
    ccdm: str = "",
    pflag: str = " ",
    posflg: str = " ",
    observed: tuple[float, float] | None = None,
) -> str:
    """One record of tyc2.dat (I/259), 206 characters."""
    seen = observed if observed is not None else (ra, dec)
    mean = ra is not None
    fields = {
        (1, 4): f"{tyc[0]:04d}",
        (6, 10): f"{tyc[1]:05d}",
        (12, 12): f"{tyc[2]}",
        (14, 14): pflag,
        (16, 27): optional(ra, "12.8f"),
        (29, 40): optional(dec, "12.8f"),
        (42, 48): optional(pm and pm[0], "7.1f"),
        (50, 56): optional(pm and pm[1], "7.1f"),
        (58, 60): "12" if mean else "",
        (62, 64): "14" if mean else "",
        (66, 69): "1.3" if mean else "",
        (71, 74): "1.4" if mean else "",
        (76, 82): "1989.95" if mean else "",
        (84, 90): "1989.52" if mean else "",
        (92, 93): "12" if mean else "",
        (95, 97): "0.9" if mean else "",
        (99, 101): "1.1" if mean else "",
        (103, 105): "0.9" if mean else "",
        (107, 109): "1.1" if mean else "",
        (111, 116): optional(bt, "6.3f"),
        (118, 122): "0.015" if bt is not None else "",
        (124, 129): optional(vt, "6.3f"),
        (131, 135): "0.010" if vt is not None else "",
        (137, 139): "999",
        (141, 141): "T",
        (143, 148): "" if hip is None else str(hip),
        (149, 151): ccdm.ljust(3),
        (153, 164): f"{seen[0]:12.8f}",
        (166, 177): f"{seen[1]:12.8f}",
        (179, 182): "1.52",
        (184, 187): "1.48",
        (189, 193): "5.0",
        (195, 199): "5.1",
        (201, 201): posflg,
        (203, 206): "-0.1",
    }
    bars = "13 15 28 41 49 57 61 65 70 75 83 91 94 98 102 106 110 117 123 130 136 140 142 152 165"
    return line(206, fields, bars + " 178 183 188 194 200 202")


def supplement_line(
    tyc: tuple[int, int, int],
    ra: float,
    dec: float,
    *,
    pm: tuple[float, float] | None,
    bt: float | None = None,
    vt: float | None = None,
    mflag: str = " ",
    hip: int | None = None,
    ccdm: str = "",
) -> str:
    """One record of suppl_1.dat (I/259), 122 characters."""
    fields = {
        (1, 4): f"{tyc[0]:04d}",
        (6, 10): f"{tyc[1]:05d}",
        (12, 12): f"{tyc[2]}",
        (14, 14): "H" if hip else "T",
        (16, 27): f"{ra:12.8f}",
        (29, 40): f"{dec:12.8f}",
        (42, 48): optional(pm and pm[0], "7.1f"),
        (50, 56): optional(pm and pm[1], "7.1f"),
        (58, 62): "1.2",
        (64, 68): "1.1",
        (70, 74): "1.0" if pm else "",
        (76, 80): "0.9" if pm else "",
        (82, 82): mflag,
        (84, 89): optional(bt, "6.3f"),
        (91, 95): "0.020" if bt is not None else "",
        (97, 102): optional(vt, "6.3f"),
        (104, 108): "0.020" if vt is not None else "",
        (110, 112): "999",
        (114, 114): "T",
        (116, 121): "" if hip is None else str(hip),
        (122, 122): ccdm,
    }
    return line(122, fields, "13 15 28 41 49 57 63 69 75 81 83 90 96 103 109 113 115")


def hipparcos_line(
    hip: int,
    ra_rad: float,
    dec_rad: float,
    *,
    pm: tuple[float, float],
    parallax: float,
    hp: float,
    colour: float | None,
    components: int = 1,
) -> str:
    """One record of hip2.dat (I/311), 276 characters; an unknown colour is 0.000 with error 0."""
    fields = {
        (1, 6): str(hip),
        (8, 10): "5",
        (12, 12): "0",
        (14, 14): str(components),
        (16, 28): f"{ra_rad:13.10f}",
        (30, 42): f"{dec_rad:13.10f}",
        (44, 50): f"{parallax:7.2f}",
        (52, 59): f"{pm[0]:8.2f}",
        (61, 68): f"{pm[1]:8.2f}",
        (70, 75): "0.66",
        (77, 82): "0.53",
        (84, 89): "0.86",
        (91, 96): "0.75",
        (98, 103): "0.66",
        (105, 107): "121",
        (109, 113): "0.06",
        (115, 116): "0",
        (118, 123): "0.0",
        (125, 128): "0",
        (130, 136): f"{hp:7.4f}",
        (138, 143): "0.0017",
        (145, 149): "0.015",
        (151, 151): "0",
        (153, 158): f"{0.0 if colour is None else colour:6.3f}",
        (160, 164): "0.000" if colour is None else "0.012",
        (166, 171): "1.040",
    }
    weights = {(172 + 7 * i, 178 + 7 * i): "0.19" for i in range(15)}
    return line(276, fields | weights)


def write(path: Path, rows: list[str], end: str = "\n") -> Path:
    """Write the records, each followed by ``end``."""
    path.write_bytes("".join(row + end for row in rows).encode("ascii"))
    return path
