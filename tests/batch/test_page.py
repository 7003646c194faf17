"""batch.html: a whole and safe page over all runs, worst first."""

from __future__ import annotations

import io
import re
from base64 import b64decode, b64encode
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mavnav.batch.files import MAX_PIXELS, thumbnail, to_page
from support.html_page import Page


def test_a_batch_leaves_its_page_worst_first(home: Path) -> None:
    page = Page(Path("runs/batch/batch.html").read_text())
    assert [re.search(r"\w+\.\w+", row)[0] for row in page.rows[1:]] == [
        "gone.bag",
        "empty.mcap",
        "cut.mcap",
        "good.mcap",
    ]
    assert "no such file" in page.rows[1]
    assert "passed" in page.rows[4]
    assert page.rows[3].count("the log is damaged") == 1
    assert re.search(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC · log of [\d.]+ s · 681 beams, .* Hz, frame \w+", page.rows[4])
    assert "UTC" not in page.rows[1]


def test_links_lead_to_what_is_there(home: Path, document: dict[str, Any]) -> None:
    directory = Path("runs/batch")
    links = [link["href"] for link in Page(to_page(document, directory)).all("a")]
    assert len(links) == 2
    assert all((directory / link).is_file() and link.endswith("/map.png") for link in links)
    (directory / links[0]).with_name("report.html").write_text("")
    assert Page(to_page(document, directory)).all("a")[0]["href"].endswith("/report.html")


def test_nothing_but_the_page_itself_is_run_or_fetched(document: dict[str, Any]) -> None:
    evil = "<script>alert(1)</script>\"onload='x"
    document["cells"][0].update(name=evil, error=evil)
    page = Page(text := to_page(document, Path("runs/batch")))
    policy = page.all("meta")[1]["content"]
    assert policy.startswith("default-src 'none'")
    for tag in ("style", "script"):
        content = re.findall(rf"<{tag}>(.*?)</{tag}>", text, re.DOTALL)
        digest = b64encode(sha256(content[0].encode()).digest()).decode()
        assert len(content) == 1
        assert f"{tag}-src 'sha256-{digest}'" in policy
    assert all(image["src"].startswith("data:image/png;base64,") for image in page.all("img"))
    assert not [name for _, attrs in page.tags for name in attrs if name.startswith("on") or name == "style"]


def test_the_same_batch_gives_the_same_bytes(document: dict[str, Any]) -> None:
    assert to_page(document, Path("runs/batch")) == to_page(document, Path("runs/batch"))


def test_what_changed_and_what_is_missing(document: dict[str, Any]) -> None:
    moved = [{"name": "map.accepted_share", "before": 1.0, "now": 0.5, "change": "worse"}]
    for row in document["cells"]:
        row["baseline"] = {"change": "same", "figures": []}
    document["cells"][2]["baseline"] = {"change": "worse", "figures": moved}
    document["baseline"] = {"worse": 1, "better": 0, "new": 0, "missing": ["logs/old.bag"]}
    text = to_page(document, Path("runs/batch"))
    assert "worse map.accepted_share" in text
    assert "<li>logs/old.bag</li>" in text
    assert '<option value="worse">worse (1)</option>' in text


def test_a_batch_of_nothing(document: dict[str, Any]) -> None:
    assert "Batch of 0 runs" in to_page({**document, "cells": []}, Path("runs/batch"))


def shades(uri: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(b64decode(uri.partition(",")[2]))).convert("L"))


def test_a_wall_of_one_cell_stays_in_a_small_picture(tmp_path: Path) -> None:
    cells = np.full((900, 700), 205, dtype=np.uint8)
    cells[100:800, 100:600] = 254
    cells[100:800, 341] = 0
    Image.fromarray(cells).save(tmp_path / "map.pgm")
    picture = shades(thumbnail(tmp_path))
    assert max(picture.shape) <= MAX_PIXELS
    assert picture.shape == (140, 100)  # the unknown edges are cut off, five cells a pixel
    dark = (picture < 100).sum(axis=1)
    assert (dark == 1).all()
    assert set(np.unique(picture)) == {24, 255}


@pytest.mark.parametrize("content", [None, b"", b"P5\n3 3\n255\nabc"], ids=["none", "empty", "cut"])
def test_a_run_without_a_map_has_no_picture(content: bytes | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "map.pgm").write_bytes(content)
    assert thumbnail(tmp_path) is None


def test_a_map_of_nothing_has_a_picture(tmp_path: Path) -> None:
    Image.fromarray(np.full((40, 30), 205, dtype=np.uint8)).save(tmp_path / "map.pgm")
    assert shades(thumbnail(tmp_path)).shape == (1, 1)
