"""Layouts: every mistake is named, places and sizes are right."""

from __future__ import annotations

import pytest
from packet_cases import EXAMPLE, SMALL, small_layout

from stcal.errors import ConfigError
from stcal.telemetry.packet_describe import describe
from stcal.telemetry.packet_layout import load_layout, parse_layout

TEXT = SMALL.format(more="")


def refused(old: str, new: str) -> str:
    assert TEXT.count(old) == 1, old
    with pytest.raises(ConfigError) as caught:
        parse_layout(TEXT.replace(old, new).encode(), "layout.toml")
    message = str(caught.value)
    assert message.startswith("layout.toml")
    return message


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('type = "i16"', 'type = "i65"', "fields.1.type|'i65' is not u1 to u64"),
        ('type = "i16"', 'type = "f16"', "'f16' is not"),
        ("scale = 0.5", "scale = 0", "scale is 0"),
        ('unit = "degC"', 'unit = "F"', "temperature_c: unit 'F' is not degC or K"),
        ('name = "frame_id"', 'name = "frame"', "no field is named frame_id"),
        ('"u32" },\n  { name = "temp', '"f32" },\n  { name = "temp', "frame_id: is a whole number"),
        ('count = "n"', 'count = "m"', "stars: count = 'm' is no field before it"),
        ('{ name = "n", type = "u8" }', '{ name = "n", type = "i8" }', "count n is not a plain"),
        ("exposure = 0", "exposure = 2", "exposure"),
        ("exposure = 0, ", "", "exposure is missing"),
        ("exposure = 0", 'exposure = "x"', "exposure = 'x' is no field outside"),
        ('name = "row_px"', 'name = "row"', "no field is named row_px"),
        (', encoding = "hip-tyc"', "", "star_id: needs encoding"),
        ('type = "u32", encoding', 'type = "u16", encoding', "hip-tyc needs type u32"),
        ('"ST16-2" = 322', '"ST16-2" = 321', "321 is given to several sensors"),
        ("[99]", "[321]", "321 is a sensor's"),
        ("[99]", '"all"', "ignored_apids"),
        ('"ST16-2" = 322', '"ST16-2" = 2048', "less than or equal to 2046"),
        ('name = "n", type', 'name = "frame_id", type', "frame_id: given more than once"),
        ('name = "col_px"', 'name = "row_px"', "stars.row_px: given more than once"),
        ("maximum = 5", "maximum = 5, of = 'stars'", "of is for matches"),
        ('type = "u8" }', 'type = "u8", valid_if = "x" }', "valid_if = 'x' is no field"),
        ('type = "u8" }', 'type = "u7", byte_order = "little" }', "no byte order"),
        ('type = "u8" }', 'type = "u8", empty = 256 }', "empty = 256 is no number"),
        ('type = "u8" }', 'type = "u8", unknown = 1 }', "unknown: Extra inputs"),
        ('"crc-16"', '"crc-32"', "error_control"),
        ('scale = "TAI"', 'scale = "UTC"', "counts TAI"),
        ("packet-layout/1", "packet-layout/2", "schema"),
        ("fields = [\n  {", "fields = [\n  1, {", "fields.0"),
        ('name = "small"', "name = ", "not TOML"),
    ],
)
def test_mistakes_are_named(old, new, said):
    message = refused(old, new)
    assert any(part in message for part in said.split("|")), message


def test_all_mistakes_at_once():
    text = TEXT.replace('"ST16-2" = 322', '"ST16-2" = 321').replace('unit = "degC"', 'unit = "F"')
    with pytest.raises(ConfigError, match=r"several sensors.*unit 'F'"):
        parse_layout(text.encode(), "x")


def test_matches_need_a_list_of_stars_before_them():
    matches = """
      {{ list = "matches", name = "ids", count = "n", maximum = 5, of = "{of}", fields = [
        {{ name = "star", type = "u8" }},
        {{ name = "star_id", type = "u32", encoding = "hip" }},
      ] }},"""
    assert small_layout(matches.format(of="stars")).lists[1].of == "stars"
    with pytest.raises(ConfigError, match="of = 'later' is no list of stars before it"):
        small_layout(matches.format(of="later"))


def test_a_packet_that_ccsds_does_not_allow():
    text = TEXT.replace('name = "n", type = "u8"', 'name = "n", type = "u32"')
    text = text.replace("maximum = 5", "maximum = 4096")
    assert parse_layout(text.encode(), "x").largest == 6 + 6 + 10 + 4096 * 8 + 2
    with pytest.raises(ConfigError, match=r"may have \d+ bytes, CCSDS allows 65542"):
        parse_layout(text.replace('"u16", scale', '"u64", scale').encode(), "x")


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        load_layout(tmp_path / "none.toml")


def test_places_and_sizes():
    layout = small_layout('  { name = "flag", type = "u1" },')
    assert layout.places == {
        "frame_id": (0, 96),
        "temperature_c": (0, 128),
        "n": (0, 144),
        "flag": (1, 0),
    }
    assert (layout.smallest, layout.largest) == (6 + 6 + 7 + 1 + 2, 6 + 6 + 7 + 40 + 1 + 2)


def test_the_example_explained():
    document = describe(load_layout(EXAMPLE))
    parts = {part["part"]: part for part in document["parts"]}
    assert document["packet_bytes"] == {"smallest": 77, "largest": 941}
    assert document["time"]["resolution_ns"] == pytest.approx(1e9 / 2**24)
    assert parts["q_x"]["column"] == "q_x"
    assert parts["q_x"]["largest"] == pytest.approx(2.0)
    assert parts["spare"]["column"] is None
    assert parts["stars_1"]["after"] == "matches_0"
    row = parts["stars_0"]["fields"][0]
    assert (row["smallest"], row["largest"]) == (-0.5, (2**20 - 1) / 256 - 0.5)
