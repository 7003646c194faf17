"""Maps of map_server as tools write them: depths, modes, shades for unknown, and what is no map."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from mavnav.errors import UsageError
from mavnav.ground_truth import map_file
from mavnav.ground_truth.map_file import read_map
from mavnav.mapping.occupancy_grid import occupancy
from support.map_files import FREE, KINDS, OCCUPIED, UNKNOWN, pgm

THRESHOLDS = {"occupied_thresh": 0.65, "free_thresh": 0.196}


def shades(unknown: int, free: int, occupied: int) -> np.ndarray:
    """Return a picture, the highest row on top."""
    return np.choose(KINDS, [unknown, free, occupied])[::-1]


def kinds(path) -> np.ndarray:
    grid = read_map(path).grid
    return np.select([occupancy(grid) == 100, occupancy(grid) == 0], [OCCUPIED, FREE], UNKNOWN)


@pytest.mark.parametrize(
    ("picture", "about"),
    [
        (pgm(shades(205, 254, 0)), THRESHOLDS | {"mode": "trinary"}),
        (pgm(shades(205, 254, 0)), {"occupied_thresh": 0.65, "free_thresh": 0.25}),
        (pgm(shades(128, 255, 0)), THRESHOLDS),
        (pgm(shades(128, 0, 255)), THRESHOLDS | {"negate": 1}),
        (pgm(shades(128, 0, 255)), THRESHOLDS | {"negate": "true"}),
        (pgm(shades(205, 254, 0), "P2"), THRESHOLDS),
        (pgm(shades(50, 100, 0), depth=100), THRESHOLDS),
        (pgm(shades(32896, 65535, 0), depth=65535), THRESHOLDS),
        (pgm(shades(255, 0, 100)), THRESHOLDS | {"mode": "raw"}),
        (pgm(shades(128, 254, 0)), THRESHOLDS | {"mode": "scale"}),
        (pgm(shades(205, 254, 0)), {}),
    ],
    ids=[
        "saver",
        "nav2 saver",
        "128",
        "negated",
        "negated in words",
        "plain",
        "depth 100",
        "16 bits",
        "raw",
        "scale",
        "no thresholds",
    ],
)
def test_the_same_map_in_many_ways(write_map, picture, about) -> None:
    np.testing.assert_array_equal(kinds(write_map(picture, **about)), KINDS)


@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA", "P"])
def test_png(write_map, mode: str) -> None:
    image = Image.fromarray(shades(205, 254, 0).astype(np.uint8)).convert(mode)
    np.testing.assert_array_equal(kinds(write_map(image.save, "map.png", **THRESHOLDS)), KINDS)


@pytest.mark.parametrize(
    ("levels", "about"),
    [
        ((205, 254, 0), {"mode": "trinary"}),
        ((128, 0, 255), {"negate": 1}),
        ((128, 254, 0), {"mode": "scale"}),
        ((255, 0, 100), {"mode": "raw"}),
    ],
    ids=["trinary", "negated", "scale", "raw"],
)
def test_a_png_of_16_bits_is_the_same_map(write_map, levels, about) -> None:
    image = Image.fromarray(shades(*levels).astype(np.uint16) * 257)
    np.testing.assert_array_equal(kinds(write_map(image.save, "map.png", **THRESHOLDS | about)), KINDS)


def test_what_is_transparent_is_unknown(write_map) -> None:
    pixels = np.stack([*[shades(0, 254, 0)] * 3, shades(0, 255, 255)], axis=2).astype(np.uint8)
    np.testing.assert_array_equal(kinds(write_map(Image.fromarray(pixels).save, "map.png", **THRESHOLDS)), KINDS)


def test_places_follow_resolution_and_origin(write_map) -> None:
    map_file = read_map(write_map(pgm(shades(205, 254, 0))))
    np.testing.assert_allclose(map_file.occupied_xy_m(), [(-1.0 + 2.5 * 0.05, 2.0 + 0.5 * 0.05)])
    turned = read_map(write_map(pgm(shades(205, 254, 0)), origin=[0, 0, 1.5707963267948966]))
    np.testing.assert_allclose(turned.occupied_xy_m(), [(-0.5 * 0.05, 2.5 * 0.05)], atol=1e-12)


def test_leading_zeros_of_an_origin_are_decimal(write_map) -> None:
    assert read_map(write_map(GOOD, origin="[010, 08, 0]")).map_T_grid == (10.0, 8.0, 0.0)


def test_what_is_left_out_is_as_it_usually_is(tmp_path) -> None:
    (tmp_path / "map.pgm").write_bytes(pgm(shades(205, 254, 0)))
    (tmp_path / "map.yaml").write_text("image: map.pgm\nresolution: 0.05\n")
    np.testing.assert_array_equal(kinds(tmp_path / "map.yaml"), KINDS)
    np.testing.assert_allclose(read_map(tmp_path / "map.yaml").occupied_xy_m(), [(2.5 * 0.05, 0.5 * 0.05)])


GOOD = pgm(shades(205, 254, 0))


@pytest.mark.parametrize(
    ("picture", "about", "word"),
    [
        (GOOD[:-3], {}, "cut short"),
        (b"P5\n0 0\n255\n", {}, "is no map"),
        (b"P5\n999999 999999\n255\n", {}, "is no map"),
        (b"P2\n2 1\n255\n7 x", {}, "no number"),
        (b"hello", {}, "no picture"),
        (b"", {}, "no picture"),
        (b"\x89PNG\r\n\x1a\n broken", {}, "no picture"),
        (GOOD, {"resolution": 0}, "no size of a cell"),
        (GOOD, {"resolution": "fine"}, "no number"),
        (GOOD, {"resolution": None}, "describes no map"),
        (GOOD, {"origin": "[1, two, 3]"}, "no pose"),
        (GOOD, {"origin": 3}, "no pose"),
        (GOOD, {"mode": "other"}, "trinary, scale, raw"),
        (GOOD, {"free_thresh": 0.7}, "not below"),
        (GOOD, {"occupied_thresh": ".inf"}, "no number"),
        (GOOD, {"image": "gone.pgm"}, "cannot be read"),
        (GOOD, {"negate": "yes please"}, "no number"),
        (GOOD, {"resolution": "true"}, "no number"),
        (GOOD, {"origin": "[true, 0, 0]"}, "no pose"),
    ],
    ids=lambda value: str(value)[:20] if not isinstance(value, bytes) else "",
)
def test_one_line_says_what_is_wrong(write_map, picture, about, word) -> None:
    image = about.pop("image", None)
    path = write_map(picture, **about)
    if image:
        path.write_text(path.read_text().replace("map.pgm", image))
    with pytest.raises(UsageError, match=word) as caught:
        read_map(path)
    assert "\n" not in str(caught.value)
    assert str(path.parent) in str(caught.value)


def test_an_image_that_is_no_picture_is_named_in_plain_words(write_map) -> None:
    path = write_map(b"image: a.yaml\n")
    with pytest.raises(UsageError) as caught:
        read_map(path)
    picture = path.parent / "map.pgm"
    assert str(caught.value) == f"{picture} is no picture of a map (PGM or PNG); mend 'image:'"


def test_blank_pixels_beyond_those_of_a_hall_are_refused(write_map, monkeypatch) -> None:
    monkeypatch.setattr(map_file, "FREE_CELLS", 1600)
    blank = np.full((40, 41), 254, np.uint8)
    save, save_fewer = Image.fromarray(blank).save, Image.fromarray(blank[:, :40]).save
    with pytest.raises(UsageError, match=r"1640 pixels in .* bytes are too many; crop it, or save it as PGM"):
        read_map(write_map(save, "map.png"))
    assert read_map(write_map(save_fewer, "map.png")).grid.passes.all()
