from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from catalog_stars import random_directions, stars

from stcal.catalog.catalogue import (
    BUNDLED,
    StarCatalogue,
    catalogue_sha256,
    load,
    load_bundled,
    save,
)
from stcal.constants import MAS
from stcal.errors import InputError


@pytest.fixture
def some_stars() -> StarCatalogue:
    rng = np.random.default_rng(5)
    direction = random_directions(rng, 50)
    return stars(
        direction,
        motion=np.cross(direction, rng.normal(0, 100 * MAS, (50, 3))),
        parallax=rng.uniform(0, 100 * MAS, 50),
        magnitude=rng.uniform(0, 8, 50),
        colour=np.where(rng.random(50) < 0.3, np.nan, rng.uniform(-0.3, 1.8, 50)),
        multiple=rng.random(50) < 0.5,
        provenance={"title": "Some stars", "inputs": {"a": "b"}},
    )


def test_a_catalogue_comes_back_from_its_file(some_stars: StarCatalogue, tmp_path: Path) -> None:
    save(some_stars, tmp_path / "c.npz")
    back = load(tmp_path / "c.npz")
    np.testing.assert_array_equal(back.direction, some_stars.direction)
    np.testing.assert_allclose(back.motion, some_stars.motion, atol=1e-4 * MAS)
    np.testing.assert_allclose(back.colour, some_stars.colour, atol=1e-6)
    for name in ("star_id", "multiple", "merged", "source"):
        np.testing.assert_array_equal(getattr(back, name), getattr(some_stars, name))
    assert back.provenance == some_stars.provenance
    assert catalogue_sha256(back) == catalogue_sha256(some_stars)
    assert back.motion.dtype == np.float64


def test_writing_again_gives_the_same_bytes(some_stars: StarCatalogue, tmp_path: Path) -> None:
    save(some_stars, tmp_path / "a.npz")
    save(load(tmp_path / "a.npz"), tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_the_hash_sees_every_column(some_stars: StarCatalogue) -> None:
    from dataclasses import replace

    before = catalogue_sha256(some_stars)
    for name in ("direction", "motion", "parallax", "magnitude", "multiple", "star_id"):
        column = getattr(some_stars, name).copy()
        column[7] = ~column[7] if column.dtype == bool else column[7] + 1
        assert catalogue_sha256(replace(some_stars, **{name: column})) != before, name


def test_the_bundled_catalogue_is_read_once() -> None:
    assert load_bundled() is load_bundled()


@pytest.mark.parametrize("keep", [0, 1, 100, 5_000, 1_000_000, 2_725_000])
def test_a_file_cut_short_is_named(keep: int, tmp_path: Path) -> None:
    path = tmp_path / "cut.npz"
    path.write_bytes(BUNDLED.read_bytes()[:keep])
    with pytest.raises(InputError, match=r"cut\.npz: cut short or not a star catalogue"):
        load(path)


def test_foreign_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    for content in (b"hello\n", gzip.compress(b"hello"), BUNDLED.read_bytes()[1000:]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"x\.npz: .*not a star catalogue"):
            load(path)
    np.savez(path, a=np.arange(3))
    with pytest.raises(InputError, match=r"x\.npz: not a star catalogue \(no header\)"):
        load(path)
    with path.open("wb") as stream:
        np.save(stream, np.arange(3))
    with pytest.raises(InputError, match=r"x\.npz: .*not a star catalogue"):
        load(path)
    with pytest.raises(InputError, match=r"nowhere\.npz: no such file"):
        load(tmp_path / "nowhere.npz")
    with pytest.raises(InputError, match="cannot be read"):
        load(tmp_path)


def rewritten(source: Path, path: Path, header: dict[str, object], **columns: object) -> Path:
    """Copy a catalogue file with another header or other columns."""
    with np.load(source) as archive:
        content = {name: archive[name] for name in archive.files}
    old = json.loads(content.pop("header").tobytes())
    text = np.frombuffer(json.dumps(old | header).encode(), dtype=np.uint8)
    with path.open("wb") as stream:
        np.savez(stream, header=text, **(content | columns))  # type: ignore[arg-type]
    return path


def test_what_is_wrong_with_a_file_is_told(some_stars: StarCatalogue, tmp_path: Path) -> None:
    good, path = tmp_path / "good.npz", tmp_path / "bad.npz"
    save(some_stars, good)
    with pytest.raises(InputError, match=r"bad\.npz: schema version 2, this version reads 1"):
        load(rewritten(good, path, {"version": 2}))
    with pytest.raises(InputError, match=r"bad\.npz: not a star catalogue \(schema"):
        load(rewritten(good, path, {"schema": "other"}))
    faint = (some_stars.magnitude + 0.5).astype("<f4")
    with pytest.raises(InputError, match=r"bad\.npz: content differs from its SHA-256"):
        load(rewritten(good, path, {}, magnitude=faint))
    with pytest.raises(InputError, match=r"bad\.npz: column parallax is not <f4 of shape \(50,\)"):
        load(rewritten(good, path, {}, parallax=np.zeros(49, "<f4")))


def test_columns_that_no_star_has_are_refused(some_stars: StarCatalogue, tmp_path: Path) -> None:
    from dataclasses import replace

    path = tmp_path / "bad.npz"
    save(replace(some_stars, magnitude=np.full(50, np.nan)), path)
    with pytest.raises(InputError, match="magnitude has values that are not finite"):
        load(path)
    save(replace(some_stars, direction=2.0 * some_stars.direction), path)
    with pytest.raises(InputError, match="not unit vectors"):
        load(path)
    save(some_stars.take(np.zeros(50, dtype=bool)), path)
    with pytest.raises(InputError, match="holds no stars"):
        load(path)
