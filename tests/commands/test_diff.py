"""``mavnav diff``: the table, the document, the picture, gates and what cannot be compared."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import mavnav as api
from mavnav.outputs.pictures.canvas import rgb_of
from mavnav.outputs.pictures.difference_picture import AREAS, GONE, NEW
from support.changed_rooms import TURNED, mapped, other_room, rooms, saved
from support.synthetic import room


@pytest.fixture(scope="module")
def maps(tmp_path_factory) -> tuple[Path, Path]:
    """Return the maps of some rooms before and after a box was moved."""
    folder = tmp_path_factory.mktemp("maps")
    return saved(mapped(rooms()), folder / "a"), saved(mapped(rooms(moved_m=0.3), seed=1), folder / "b")


def test_what_changed_is_listed_and_drawn(mavnav, maps, tmp_path) -> None:
    picture = tmp_path / "diff.png"
    page = picture.with_suffix(".html")
    words = ("-o", picture, "--report", page, "--gate", "changed_m2<=0.01")
    code, out, err = mavnav("diff", *maps, "-q", "--json", *words)
    document = json.loads(out)
    assert (code, document["exit_code"]) == (1, 1)
    assert "gate changed_m2<=0.01 failed: it is 0.0" in err
    assert (document["gone"], document["new"], document["moved"]) == (1, 1, 1)
    assert [change["moved_with"] for change in document["changes"]] == [2, 1]
    assert document["changed_m2"] == pytest.approx(document["gone_m2"] + document["new_m2"])
    assert document["alignment"]["agreeing"] >= 6
    pixels = np.asarray(Image.open(picture))
    assert b64encode(picture.read_bytes()).decode() in page.read_text()
    assert all((pixels == rgb_of(colour)).all(axis=2).sum() > 50 for colour in (GONE, NEW))
    legend = pixels[-45:-10]
    assert all((legend == rgb_of(area.colour)).all(axis=2).sum() > 200 for area in AREAS)
    code, out, err = mavnav("diff", *maps, "-q")
    rows = dict(re.split(r"  +", line, maxsplit=1) for line in out.splitlines())
    assert (code, err) == (0, "")
    assert rows["result"] == document["headline"]
    assert re.match(r"1 place gone \(.* m²\), 1 place new \(.* m²\), 1 object moved; .* % of the", rows["result"])
    assert re.fullmatch(r"(gone|new) at .* m², 0\.\d\d m long, moved with 2", rows["change 1"])
    code, out, err = mavnav("diff", *maps, "-q", "-o", picture)
    assert (code, out) == (6, "")
    assert "--force" in err


@pytest.mark.slow
def test_changes_that_are_not_printed_are_in_json(mavnav, maps, monkeypatch) -> None:
    monkeypatch.setattr("mavnav.commands.diff.LISTED", 0)
    assert "2 more; --json lists them" in mavnav("diff", *maps, "-q")[1]
    assert len(json.loads(mavnav("diff", *maps, "-q", "--json")[1])["changes"]) == 2


def test_the_same_map_passes(mavnav, maps) -> None:
    code, out, err = mavnav("diff", maps[0], maps[0], "-q", "--gate", "changed_m2==0", "--gate", "same_share>0.99")
    assert (code, err) == (0, "")
    assert out.startswith("result  No change; 100.0 % of the walls are the same on ")
    assert "-0.000 m" not in out


@pytest.mark.slow
def test_maps_of_different_places(mavnav, maps, tmp_path) -> None:
    """A gate on a number that is not known fails."""
    other = saved(mapped(room(9.0, 2.2), TURNED, poses=[(1.0, 1.1), (4.0, 1.1), (8.0, 1.0)]), tmp_path / "other")
    code, out, err = mavnav("diff", maps[0], other, "-q", "--gate", "gone<=9", "-o", tmp_path / "diff.png")
    assert (code, out) == (1, "")
    assert "cannot be aligned" in err
    assert "gate gone<=9 failed: it is not known" in err
    assert not (tmp_path / "diff.png").exists()
    document = api.diff(maps[0], other)
    assert (document["alignment"], document["changed_m2"], document["changes"]) == (None, None, [])


@pytest.mark.slow
@pytest.mark.parametrize(("a", "b"), [(24, 20), (26, 29)])
def test_rooms_of_which_few_walls_are_the_same_are_not_one(a: int, b: int, mavnav, tmp_path) -> None:
    """Seven and five of twelve places agree, from both sides, on 59 and 71 % of the walls."""
    maps = [saved(other_room(seed), tmp_path / str(seed)) for seed in (a, b)]
    code, out, err = mavnav("diff", *maps, "-q")
    assert (code, out) == (1, "")
    assert "cannot be aligned; too few places of one fit the other" in err


def test_a_search_that_ends_early_says_so(mavnav, maps, monkeypatch) -> None:
    monkeypatch.setattr("mavnav.pipelines.diff.align", lambda *_: (None, False))
    code, out, err = mavnav("diff", *maps, "-q", "--json")
    assert (code, json.loads(out)["searched_all"]) == (1, False)
    assert err.endswith("cannot be aligned; the search ended early: nearly every place fits\n")


def test_what_cannot_be_compared(mavnav, maps, tmp_path) -> None:
    empty = saved(mapped(room(), poses=np.zeros((0, 2))), tmp_path / "empty")
    log = tmp_path / "drive.mcap"
    log.touch()
    for args, word in (
        ([maps[0], tmp_path / "gone"], "no such file"),
        ([maps[0], tmp_path], "holds no map of a run (hits.npz: no such file)"),
        ([maps[0], log], "is no map; name a run directory"),
        ([maps[0], empty], "no occupied cell"),
        ([*maps, "--gate", "changed<=2"], "it has compared_m2"),
        ([maps[0], tmp_path / "gone", "-o", tmp_path / "d12"], "d12 is no PNG file; name it with .png"),
        ([maps[0]], "Missing argument"),
    ):
        code, out, err = mavnav("diff", *args, "-q")
        assert (code, out, err.count("\n")) == (2, "", 1), args
        assert word in err, args
    assert not (tmp_path / "d12").exists()
