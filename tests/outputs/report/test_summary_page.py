"""The pages of merge, diff and calibrate: all that their documents say, in one file that loads nothing."""

from __future__ import annotations

import re
from base64 import b64decode
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from mavnav.errors import OutputError, UsageError
from mavnav.outputs.directory import check_file, write_file
from mavnav.outputs.report.summary_page import (
    Summary,
    calibration_summary,
    diff_summary,
    draw_png,
    merge_summary,
    write_summary,
)

PNG = b"\x89PNG picture"
SESSION: dict[str, Any] = {
    "name": "monday", "input": "logs/monday.bag", "scans": 200, "joined": True, "why": None,
    "joined_to": [{"name": "friday", "closures": 12}], "closures": 12, "tested": 14, "residual_mm": 8.2,
    "tracking": {"tracked_share": 0.994, "doubt": {"probability": 0.03}},
    "verdict": {"word": "good", "reason": "no sign", "advice": ""},
    "damage": [{}, {}],
}  # fmt: skip
SUSPECT = {"word": "suspect", "reason": "other did not join", "advice": "record more"}
MERGED = {
    "verdict": SUSPECT,
    "headline": "2 of 3 sessions are in one map, with 500 scans.",
    "joined": 2,
    "scans": 500,
    "sessions": [
        SESSION,
        SESSION
        | {
            "name": "friday",
            "input": "runs/friday",
            "joined_to": [],
            "tested": 0,
            "tracking": None,
            "verdict": None,
            "damage": [],
        },
        SESSION | {"name": "other <b>", "joined": False, "why": "too few scans fit", "joined_to": [], "tested": 0},
    ],
}
DIFFERENCE = {
    "a": "runs/a", "b": "runs/b", "headline": "1 place gone (0.250 m²); 98.7 % are the same.",
    "verdicts": {"a": SUSPECT, "b": None},
    "gone": 1, "gone_m2": 0.25, "new": 0, "new_m2": 0.0, "moved": 0, "compared_m2": 31.4,
    "same_share": 0.987, "alignment": {"x_m": 0.1, "y_m": -0.2, "yaw_deg": 3.0, "rms_mm": 11.0},
    "changes": [{"number": 1, "kind": "gone", "x_m": 1.5, "y_m": 2.5, "m2": 0.25, "length_m": 0.9, "moved_with": None}],
}  # fmt: skip
SWITCH = {"value": True, "in_log": False, "agrees": False, "refused": None}
CALIBRATED = {
    "verdict": SUSPECT,
    "headline": "The laser is mounted the other way up.",
    "refused": None,
    "quantities": [
        {
            "name": "x_m",
            "unit": "m",
            "value": 0.0302,
            "ci95": 0.009,
            "in_log": 0.03,
            "difference": 0.0002,
            "refused": None,
        },
        {"name": "turn_scale", "value": None, "ci95": None, "in_log": 1, "difference": None, "refused": "no turns"},
    ],
    "upside_down": SWITCH,
    "beams_reversed": SWITCH | {"value": False},
    "range_bias": SWITCH | {"value": None, "refused": "not seen"},
    "lines": {"static_transform": "ros2 run <line>", "replay": None},
}


def page(summary: Summary, tmp_path: Path) -> str:
    """Return the page of a summary."""
    write_summary(summary, tmp_path / "page.html")
    return (tmp_path / "page.html").read_text()


def rows(text: str) -> list[list[str]]:
    """Return the texts of the rows of all tables."""
    found = re.findall(r"<tr>(.*?)</tr>", text, re.DOTALL)
    return [[unescape(cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row)] for row in found]


def test_a_merge_shows_every_session(tmp_path: Path) -> None:
    text = page(merge_summary(MERGED, PNG), tmp_path)
    assert "2 of 3 sessions are in one map, with 500 scans." in text
    assert '<p class="verdict suspect"><strong>suspect</strong>: other did not join; record more</p>' in text
    assert rows(text)[1:] == [
        ["monday", "logs/monday.bag", "good", "200", "friday (12)", "12 of 14", "8 mm", "99.4 %", "2 places"],
        ["friday", "runs/friday", "", "200", "the first of the group", "", "", "", "none"],
        ["other <b>", "logs/monday.bag", "good", "200", "not joined", "", "", "99.4 %", "2 places"],
        ["session", "input", "reason"],
        ["other <b>", "logs/monday.bag", "too few scans fit"],
    ]


def test_the_picture_stands_in_the_page_which_loads_nothing(tmp_path: Path) -> None:
    text = page(merge_summary(MERGED, PNG), tmp_path)
    (picture,) = re.findall(r'<img src="data:image/png;base64,([^"]*)"', text)
    assert b64decode(picture) == PNG
    assert "default-src 'none'" in text
    assert not re.search(r'(src|href)="(?!data:)', text)


def test_a_difference_shows_every_change_and_the_alignment(tmp_path: Path) -> None:
    text = page(diff_summary(DIFFERENCE, PNG), tmp_path)
    assert "1 place gone (0.250 m²)" in text
    assert '<p class="verdict suspect">runs/a: <strong>suspect</strong>: other did not join; record more</p>' in text
    assert ["1", "gone", "1.50 m", "2.50 m", "0.250 m²", "0.90 m", ""] in rows(text)
    assert ["0.100 m", "-0.200 m", "3.00 deg", "11 mm"] in rows(text)


def test_maps_that_cannot_be_aligned_have_a_page_too(tmp_path: Path) -> None:
    apart = DIFFERENCE | {"alignment": None, "headline": "The maps cannot be aligned."}
    text = page(diff_summary(apart, None), tmp_path)
    assert "cannot be aligned" in text
    assert not rows(text)
    assert "<img" not in text


def test_a_calibration_shows_what_is_found_and_what_is_not(tmp_path: Path) -> None:
    text = page(calibration_summary(CALIBRATED, "drive", PNG), tmp_path)
    assert "The laser is mounted the other way up." in text
    assert ["x, m", "0.030", "± 0.009", "0.030", "0.000"] in rows(text)
    assert ["upside down", "yes", "", "no", ""] in rows(text)
    assert '<table class="summary prose">' in text
    assert ["turn scale", "no turns"] in rows(text)
    assert '<td data-label="reason">no turns</td>' in text
    assert "ros2 run &lt;line&gt;</pre>" in text


def test_long_lines_are_whole_on_screen_and_paper(tmp_path: Path) -> None:
    text = page(calibration_summary(CALIBRATED, "drive", PNG), tmp_path)
    assert "\npre { white-space: pre-wrap; overflow-wrap: anywhere; }" in text[: text.index("@media print")]


def test_a_picture_is_not_longer_than_a_sheet_of_paper(tmp_path: Path) -> None:
    text = page(calibration_summary(CALIBRATED, "drive", PNG), tmp_path)
    assert re.search(r"figure img \{[^}]*max-height: 23cm;", text[text.index("@media print") :])


def test_a_picture_is_drawn_to_bytes() -> None:
    assert draw_png(lambda path: path.write_bytes(PNG) and None) == PNG


def test_a_file_is_checked_before_the_work(tmp_path: Path) -> None:
    there = tmp_path / "page.html"
    there.write_text("old")
    check_file(None, ".html", force=False)
    check_file(there, ".html", force=True)
    with pytest.raises(OutputError, match="exists"):
        check_file(there, ".html", force=False)
    with pytest.raises(OutputError, match="is a directory"):
        check_file(tmp_path, ".html", force=False)
    with pytest.raises(UsageError, match=r"name it with \.html"):
        check_file(tmp_path / "page", ".html", force=False)


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        write_file(tmp_path / "file" / "page.html", lambda path: path.write_text("x") and None, force=False)
