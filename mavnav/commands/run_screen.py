"""The screen that ends a run: the verdict, what was read and used, the map, its size and walls, what to open.

It has at most 40 lines; ``mavnav metrics`` and ``-v`` show the rest. Below it are the warnings, the worst first.
Rows on the quality of a map are those of other commands, too; a number that is not known has no row.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Final

from mavnav.commands import shared
from mavnav.commands.terminal import Json, Rows, emit_json, note, print_table, verdict_mark, verdict_rows
from mavnav.errors import ExitCode
from mavnav.units import MM, pluralize

MAP_LINES: Final = 15
"""Maximum height of the map on a screen, in lines."""

MOST_NAMED: Final = 2
"""Maximum number of stretches without a pose that are named."""

MOST_WARNINGS: Final = 4
"""Maximum number of warnings that are printed without ``-v``."""


def print_run(
    document: Json, directory: Path, about: Rows, measures: Rows, *, json: bool, preview: bool | None, verbose: bool
) -> None:
    """Print a run on stdout: run.json with ``json``, else its screen.

    ``about`` are the rows above the map and ``measures`` those below. The map is drawn on a terminal unless ``preview``
    is False, elsewhere if it is True; with ``json`` on stderr. What the user must not miss follows on stderr.
    """
    from mavnav.outputs.documents.quantities import UNUSABLE

    terminal = sys.stdout.isatty()
    drawn = (terminal and not json if preview is None else preview) and (directory / "hits.npz").is_file()
    if json:
        emit_json(document)
    else:
        above = [*verdict_rows(document["verdict"]), *about]
        below = [*measures, *(_more(document) if verbose else ()), *_closing_rows(directory, document)]
        width = max(len(name) for name, _ in (*above, *below))
        print_table(above, width, {above[0][0]: verdict_mark(document["verdict"]["word"])[1]})
    if drawn:
        shared.show_preview(directory, lines=MAP_LINES, stderr=json)
    if not json:
        print_table([("", ""), *below] if drawn else below, width)
    bad = document["verdict"]["word"] in UNUSABLE
    note_run(document, verdict=json or (bad and not terminal), all_=verbose)


def log_rows(document: Json) -> Rows:
    """Yield the rows on what was read, and what was used of it."""
    log, scans, tracking = document["input"], document["scans"], document["tracking"]
    loops = len(document["loop_closure"]["closures"])
    skipped = "" if scans["processed"] == scans["total"] else f", {scans['processed']} of them used"
    name = " ".join(Path(part).name or part for part in [log["path"], *log.get("parts", [])])
    yield "log", f"{name}, {log['duration_s']:.1f} s, {pluralize(scans['total'], 'scan')}{skipped}"
    share = f"{100 * scans['accepted'] / max(scans['processed'], 1):.1f} % of the scans have a pose"
    closed = f"{pluralize(loops, 'loop')} closed" if loops else "no loop closed"
    yield "used", "; ".join((share + _without_pose(tracking["intervals"]), _odometry_text(document), closed))
    yield from refusal_rows(document)


def refusal_rows(document: Json) -> Rows:
    """Yield the row on the scans that the paper's method refused, by rule."""
    if refused := document["scans"].get("refused"):
        yield "refused", "; ".join(_refusal_text(each) for each in refused)


def _refusal_text(refused: Json) -> str:
    """Describe the scans that one rule refused: how many, and the median and the worst of what was refused."""
    median, worst = refused["median"], refused["worst"]
    why = {
        "cost": f"{median:.1f} times the threshold, {worst:.1f}",
        "share": f"{100 * median:.0f} % of the beams agree, {100 * worst:.0f} %",
        "beams": f"{median:.0f} valid, {worst:.0f}",
    }
    return f"{pluralize(refused['scans'], 'scan')} by {refused['rule']} ({why[refused['rule']]} at worst)"


def _without_pose(intervals: list[Json]) -> str:
    """Name the stretches of scans without a pose; a jump of the path is none."""
    lost = [each for each in intervals if each["scans"]]
    named = [f"{each['start_s']:.1f} to {each['end_s']:.1f} s" for each in lost[:MOST_NAMED]]
    more = f" and {pluralize(len(lost) - MOST_NAMED, 'other stretch')}" if len(lost) > MOST_NAMED else ""
    return f", none from {', '.join(named)}{more}" if lost else ""


def _odometry_text(document: Json) -> str:
    """Describe what was corrected of the odometry, and its errors."""
    odometry = document["tracking"].get("odometry")
    if odometry is None and document["config"]["method"] == "paper":
        return "the method uses no odometry"
    if odometry is None:
        return "odometry switched off" if document["config"]["odom"] == "off" else "no odometry"
    name = f"odometry {document['input']['odometry']['topic']}"
    if not odometry["used"]:
        return f"{name} not used, it contradicts the scans"
    changes = [f"{odometry['offset_s']:+.2f} s"] if odometry["offset_s"] else []
    for kind in ("distance", "turn"):
        scale = odometry[f"{kind}_scale"]
        changes += [f"{kind}s x {scale:.3g}"] if round(scale, 2) != 1.0 else []
    noise = odometry["noise"]["m_per_m"]
    text = f"{name} corrected by {', '.join(changes)}" if changes else f"{name} as recorded"
    return text + (f", off the track by {100 * noise:.0f} % of the distance" if noise is not None else "")


def map_rows(document: Json) -> Rows:
    """Yield the rows on the size of the map, its walls and the path."""
    if "map" in document:
        drawn, ghosts = document["map"], document["map_quality"]["ghost_walls"]
        width_m, height_m = drawn["size_m"]
        yield "map", f"{width_m:.1f} x {height_m:.1f} m, cells of {drawn['cell_mm']:g} mm"
        if "spread" in document["wall_thickness"]:
            yield "walls", spread_text(document["wall_thickness"]["spread"])
        if ghosts["count"]:
            length = f"{ghosts['length_m']:.1f} m, up to {ghosts['worst_offset_mm']:.0f} mm apart"
            yield "ghost walls", f"{ghosts['count']}, {length}"
    yield "path", f"{document['tracking']['path_length_m']:.2f} m"


def _more(document: Json) -> Rows:
    """Yield the rows that only ``-v`` shows."""
    timing = document["timing"]
    if quality := document.get("map_quality"):
        yield from chain(wall_rows(document), quality_rows(quality), more_rows(quality))
    yield "speed", f"{timing['scans_per_s']:.0f} scans/s, {timing['realtime_factor']:.1f} times real time"
    if "scan" in timing:
        yield "a scan takes", scan_time_text(timing)


def scan_time_text(timing: Json) -> str:
    """Say what a scan takes in the tracker, beside the time until the next one, and what memory the process took."""
    scan, memory_mb = timing["scan"], timing["peak_memory_mb"]
    times = f"{scan['median_ms']:.1f} ms, 95 % within {scan['p95_ms']:.1f}, at most {scan['max_ms']:.1f}"
    memory = "" if memory_mb is None else f"; {memory_mb:.0f} MB of memory in all"
    period = "" if scan["period_ms"] is None else f", of the {scan['period_ms']:.0f} ms until the next"
    return f"{times}{period}{memory}"


def _closing_rows(directory: Path, document: Json) -> Rows:
    """Yield the rows that end a screen: what to open, and the next command."""
    here, outputs = shlex.quote(str(directory)), document["outputs"]
    page = ["report.html"] if (directory / "report.html").exists() else []
    names = [*page, *(name for name in ("map.png", "true_map.png", "map_3d.png") if name in outputs)]
    yield "open", ", ".join(str(directory / name) for name in names) or str(directory)
    posed, log = document["scans"]["accepted"], [document["input"]["path"], *document["input"].get("parts", ())]
    measurable = posed and outputs.keys() >= {"trajectory.tum", "hits.npz", "result.mcap"}
    explained = not posed and not document.get("mission") and all(map(os.path.exists, log))
    check = shlex.join(["mavnav", "info", *log]) if explained else f"mavnav check {here}"
    yield "next", f"mavnav metrics {here}" if measurable else check


def note_run(document: Json, *, verdict: bool, all_: bool = False) -> None:
    """Print on stderr what the user must not miss of a run: its ``verdict`` if that is wanted, and the warnings."""
    known = document["verdict"]
    if verdict and known["word"] != "good":
        kind = "error" if document["exit_code"] == ExitCode.TRACKING_LOST else "warning"
        advice = f"; {known['advice']}" if known["advice"] else ""
        note(f"mavnav: {kind}: {known['word']}: {known['reason']}{advice}")
    if document["damage"]:
        first, places = document["damage"][0], pluralize(len(document["damage"]), "place")
        text = f"the input is damaged in {places}, the first: {first['what']}, {first['where']}"
        note(f"mavnav: warning: {text}; what is intact was used")
    note_warnings(document["warnings"], all_=all_)
    if document["partial"]:
        done, usable = document["scans"]["processed"], document["scans"]["usable"]
        where = f"after {done} of {usable} scans" if done < usable else "in the passes over the whole log"
        note(f"mavnav: stopped {where}; the run is partial")


def note_warnings(warnings: Iterable[str], *, all_: bool = False) -> None:
    """Print warnings on stderr; those that differ in numbers only count as one, and few are printed unless ``all_``."""
    groups: dict[str, list[str]] = {}
    for text in dict.fromkeys(warnings):
        groups.setdefault(re.sub(r"[0-9.]+", "#", text), []).append(text)
    for first, *others in [*groups.values()][: None if all_ else MOST_WARNINGS]:
        note(f"mavnav: warning: {first}" + (f" ({len(others)} more of this kind)" if others else ""))
    if (hidden := len(groups) - MOST_WARNINGS) > 0 and not all_:
        note(f"mavnav: {pluralize(hidden, 'more warning')} in run.json; -v prints them")


def wall_rows(document: Json) -> Rows:
    """Yield the rows on wall thickness of a summary table."""
    walls = document["wall_thickness"]
    if "spread" in walls:
        yield "wall thickness", spread_text(walls["spread"])
    paper = walls.get("paper_cells")
    if paper and paper["max"] is not None:
        counted = f"median {paper['median']:.1f}, p95 {paper['p95']:.1f}, max {paper['max']:.1f} cells"
        yield "cells across walls", f"{counted} of >= {paper['min_hits']} hits"
    published = walls["published_map"]
    length = f"{published['length_m']:.1f} m of occupied cells along straight lines"
    yield "walls in map.pgm", f"{_thickness(published)} ({length})" if published["sections"] else "no straight wall"


def spread_text(spread: Json) -> str:
    """Describe the wall thickness, and the length and share of the walls that it was measured on."""
    if spread["median_mm"] is None:
        return "no straight wall to measure"
    share = f"{spread['length_m']:.1f} m, {100 * spread['measured_share']:.0f} % of the straight walls in the scans"
    return f"{_thickness(spread)} ({share})"


def _thickness(walls: Json) -> str:
    return f"median {walls['median_mm']:.0f} mm, p95 {walls['p95_mm']:.0f} mm"


def quality_rows(quality: Json) -> Rows:
    """Yield the rows on ``map_quality`` of a document that a summary shows."""
    ghosts, revisits = quality["ghost_walls"], quality["revisits"]
    apart = f"{ghosts['length_m']:.1f} m, up to {ghosts['worst_offset_mm']:.0f} mm apart" if ghosts["count"] else ""
    yield "ghost walls", f"{ghosts['count']}, {apart}" if apart else "none"
    if revisits and revisits["nn_l_mm"] is not None:
        near = "" if revisits["nn_s_mm"] is None else f", neighbors {revisits['nn_s_mm']:.1f} mm"
        yield "revisits", f"{revisits['nn_l_mm']:.1f} mm apart{near}"
    for why in quality["why"]:
        yield "not meaningful", why


def more_rows(quality: Json) -> Rows:
    """Yield the other rows on ``map_quality``."""
    crisp, areas, support = quality["crispness"], quality["enclosed_areas"], quality["support"]
    if crisp["occupied_cells_per_m"] is not None:
        yield "crispness", f"{crisp['occupied_cells_per_m']:.0f} occupied cells per meter of wall (fewer is crisper)"
    if crisp["entropy_bits"] is not None:
        yield "entropy", f"{crisp['entropy_bits']:.3f} bits per hit cell (lower is crisper)"
    for name, share, text in (
        ("accepted", support["mapped_share"], "of the scans"),
        ("explained", support["explained_share"], "of what the laser saw lies on the map"),
        ("occupied", quality["occupied_share"], "of the known cells"),
    ):
        if share is not None:
            yield name, f"{100 * share:.1f} % {text}"
    yield "corners", str(quality["corners"])
    yield "enclosed areas", f"{areas['count']}, {areas['area_m2']:.2f} m2"


MOST_COMPARED: Final = 0.95
"""Share of the poses with a true one from which on the errors are taken for those of the whole path."""


def reference_rows(reference: Json | None) -> Rows:
    """Yield the rows on the comparison with references."""
    errors = reference or {}
    if errors.get("ate"):
        ate, rpe = errors["ate"], errors["rpe"]
        part = f", of {100 * ate['share']:.0f} % of the poses" if ate["share"] < MOST_COMPARED else ""
        yield "ATE, aligned", f"{ate['rmse_m'] / MM:.1f} mm rmse, {ate['max_m'] / MM:.1f} mm max{part}"
        if rpe["distance_rmse_m"] is not None:
            yield f"RPE per {rpe['delta_m']:g} m", _relative(rpe)
    elif "ate" in errors:
        yield "ATE, aligned", "unknown: too few poses lie between true ones that are near in time"
    if "map_distance" in errors and (d := errors["map_distance"])["cells"]:
        share = d["covered_share"]
        covered = f"{100 * share:.0f} % of the true walls mapped" if share is not None else "no wall at flight height"
        yield "true map", f"{d['mean_mm']:.0f} mm off, 95 % within {d['p95_mm']:.0f} mm; {covered}, {d['alignment']}"
    if "relations" in errors:
        r = errors["relations"]["all"]
        mean = f"{r['translation_mean_m'] / MM:.1f} mm, {r['rotation_mean_deg']:.2f} deg; " if r["scored"] else ""
        yield "relations", f"{mean}{r['scored']} of {r['relations']}"


def _relative(rpe: Json) -> str:
    if rpe["translation_rmse_m"] is None:
        return f"{rpe['distance_rmse_m'] / MM:.1f} mm of distance (the truth has no headings)"
    return f"{rpe['translation_rmse_m'] / MM:.1f} mm, {rpe['rotation_rmse_deg']:.2f} deg"
