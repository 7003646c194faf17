"""A page of one picture and some tables: for merge, diff and calibrate, whose results are not the run of one log."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

from mavnav.atomic_files import temporary_folder
from mavnav.units import pluralize
from mavnav.version import __version__


class PageTable(NamedTuple):
    """A table of the page: heading, names of the columns, and rows of texts; ``prose`` for sentences, not numbers."""

    heading: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    prose: bool = False


class Summary(NamedTuple):
    """The content of the page, with the ``tables`` that have rows; ``lines`` are commands to copy.

    ``picture`` is a PNG file, None for none. ``verdicts`` are those of what was compared, by its name, or that of the
    result by an empty name.
    """

    title: str
    headline: str
    tables: tuple[PageTable, ...]
    picture: bytes | None = None
    lines: tuple[str, ...] = ()
    verdicts: tuple[tuple[str, dict[str, str]], ...] = ()


def draw_png(draw: Callable[[Path], None]) -> bytes:
    """Return the PNG file that a function writes to a path."""
    with temporary_folder() as folder:
        path = folder / "picture.png"
        draw(path)
        return path.read_bytes()


def write_summary(summary: Summary, path: Path) -> None:
    """Write the page as one HTML file without links to other files."""
    from mavnav.outputs.report.html import environment, inline  # noqa: PLC0415  jinja2 takes long to load

    templates = environment("mavnav.outputs.report")
    page = templates.get_template("summary.html").render(
        summary=summary,
        picture=b64encode(summary.picture).decode() if summary.picture else "",
        style=inline(templates, "report.css"),
        script=None,
        version=__version__,
        profile=None,
    )
    path.write_text(page, "utf-8", "backslashreplace")  # names need not be UTF-8


def merge_summary(document: dict[str, Any], picture: bytes) -> Summary:
    """Return the page of merge.json and the picture of the map."""
    sessions = document["sessions"]
    rows = [_session_row(each) for each in sessions]
    table = PageTable("Sessions", tuple(rows[0]), tuple(tuple(row.values()) for row in rows))
    refused = tuple((each["name"], each["input"], each["why"]) for each in sessions if not each["joined"])
    others = PageTable("Not joined", ("session", "input", "reason"), refused, prose=True)
    title, verdicts = ", ".join(each["name"] for each in sessions), (("", document["verdict"]),)
    return Summary(title, document["headline"], (table, others), picture, verdicts=verdicts)


def _session_row(session: dict[str, Any]) -> dict[str, str]:
    """Return the texts of a session by their headings."""
    tracking, damage = session["tracking"] or {}, len(session["damage"])
    to = ", ".join(f"{other['name']} ({other['closures']})" for other in session["joined_to"])
    return {
        "session": session["name"],
        "input": session["input"],
        "verdict": (session["verdict"] or {"word": ""})["word"],
        "scans": str(session["scans"]),
        "joined to": to or ("the first of the group" if session["joined"] else "not joined"),
        "key frames that agree": f"{session['closures']} of {session['tested']}" if session["tested"] else "",
        "residual": f"{session['residual_mm']:.0f} mm" if to else "",
        "tracked": f"{100 * tracking['tracked_share']:.1f} %" if tracking.get("tracked_share") is not None else "",
        "damage": pluralize(damage, "place") if damage else "none",
    }


def diff_summary(document: dict[str, Any], picture: bytes | None) -> Summary:
    """Return the page of the document of ``mavnav diff``; its picture is None if the maps could not be aligned."""
    title, pose = f"{document['a']} and {document['b']}", document["alignment"]
    if pose is None:
        return Summary(title, document["headline"], ())
    head = ("change", "kind", "x", "y", "area", "length", "moved with")
    x, y = (f"{pose[key]:z.3f} m" for key in ("x_m", "y_m"))
    placed = (x, y, f"{pose['yaw_deg']:z.2f} deg", f"{pose['rms_mm']:.0f} mm")
    alignment = PageTable("Pose of the second map in the first", ("x", "y", "yaw", "RMS of the walls"), (placed,))
    verdicts = tuple((document[name], known) for name, known in document["verdicts"].items() if known)
    tables = (PageTable("Changes", head, tuple(map(_change_row, document["changes"]))), alignment)
    return Summary(title, document["headline"], tables, picture, verdicts=verdicts)


def _change_row(change: dict[str, Any]) -> tuple[str, ...]:
    place = f"{change['x_m']:z.2f} m", f"{change['y_m']:z.2f} m"
    size = f"{change['m2']:.3f} m²", f"{change['length_m']:.2f} m"
    return str(change["number"]), change["kind"], *place, *size, str(change["moved_with"] or "")


def calibration_summary(document: dict[str, Any], title: str, picture: bytes | None) -> Summary:
    """Return the page of the document of ``mavnav calibrate``."""
    switches = [{"name": name, **document[name]} for name in ("upside_down", "beams_reversed", "range_bias")]
    every = [*document["quantities"], *switches]
    rows = tuple(_calibrated_row(each) for each in every if not each["refused"])
    refused = tuple((_quantity_name(each)[0], each["refused"]) for each in every if each["refused"])
    head = ("quantity", "value", "95 % interval", "log or configuration", "difference")
    missing = PageTable("Not determined", ("quantity", "reason"), refused, prose=True)
    tables = (PageTable("Quantities", head, rows), missing)
    lines, verdicts = tuple(filter(None, document["lines"].values())), (("", document["verdict"]),)
    return Summary(title, document["headline"], tables, picture, lines, verdicts)


QUANTITY_NAMES: Final = {
    "x_m": ("x", 3),
    "y_m": ("y", 3),
    "yaw_deg": ("yaw", 2),
    "offset_s": ("time offset", 3),
    "distance_scale": ("distance scale", 4),
    "turn_scale": ("turn scale", 4),
    "veer_deg_per_m": ("veer", 2),
}
"""Calibrated quantity -> its name in tables, and its digits there."""


def _quantity_name(row: dict[str, Any]) -> tuple[str, int]:
    return QUANTITY_NAMES.get(row["name"], (row["name"].replace("_", " "), 0))


def _calibrated_row(row: dict[str, Any]) -> tuple[str, ...]:
    """Return name and unit, value, half-width of the interval, what the log says, and the difference."""
    name, digits = _quantity_name(row)
    keys = ("value", "ci95", "in_log", "difference")
    value, within, in_log, difference = (_text(row.get(key), digits) for key in keys)
    unit = f", {row['unit']}" if row.get("unit") else ""
    return f"{name}{unit}", value, f"± {within}" if within else "", in_log, difference


def _text(value: float | None, digits: int) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else f"{value:z.{digits}f}"
