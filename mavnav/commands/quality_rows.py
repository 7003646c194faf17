"""Rows of a summary table on the quality of a map; a number that is not known has no row."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING, Any

from mavnav.units import MM

if TYPE_CHECKING:
    from pathlib import Path

Rows = list[tuple[str, str]]


def doubt_rows(doubt: dict[str, Any]) -> Rows:
    """Return the row on ``tracking.doubt`` of a summary table, where the doubt is high."""
    from mavnav.slam.findings import HIGH

    probability = doubt["probability"]
    if probability is None or probability <= HIGH:
        return []
    reasons = ", ".join(dict.fromkeys(reason["reason"] for reason in doubt["reasons"]))
    return [("doubtful", f"{100 * probability:.0f} %: {reasons}")]


def wall_rows(document: dict[str, Any]) -> Rows:
    """Return the rows on wall thickness of a summary table."""
    walls = document["wall_thickness"]
    rows = [("wall thickness", _spread(walls["spread"]))] if "spread" in walls else []
    paper = walls.get("paper_cells")
    if paper and paper["max"] is not None:
        counted = f"median {paper['median']:.1f}, p95 {paper['p95']:.1f}, max {paper['max']:.1f} cells"
        rows.append(("cells across walls", f"{counted} of >= {paper['min_hits']} hits"))
    return [*rows, ("walls in map.pgm", _cells(walls["published_map"]))]


def _spread(spread: dict[str, Any]) -> str:
    if spread["median_mm"] is None:
        return "no straight wall to measure"
    share = f"{spread['length_m']:.1f} m, {100 * spread['measured_share']:.0f} % of the straight walls in the scans"
    return f"median {spread['median_mm']:.0f} mm, p95 {spread['p95_mm']:.0f} mm ({share})"


def _cells(wall: dict[str, Any]) -> str:
    if not wall["sections"]:
        return "no straight wall"
    return f"median {wall['median_mm']:.0f} mm, p95 {wall['p95_mm']:.0f} mm"


def page_row(directory: Path) -> Rows:
    """Return the row that names the run's page, where there is one."""
    page = directory / "report.html"
    return [("report", str(page))] if page.exists() else []


def picture_row(directory: Path, document: dict[str, Any], other: str) -> Rows:
    """Return the row that names the pictures that were written: ``map.png``, another, and that of the slices."""
    written = [name for name in ("map.png", other, "map_3d.png") if name in document["outputs"]]
    return [("pictures", ", ".join(str(directory / name) for name in written))] if written else []


def closing_rows(directory: Path, document: dict[str, Any], other: str) -> Rows:
    """Return the rows that end a summary: the pictures, ``map.png`` and another, the page, the run, the next step."""
    here = quote(str(directory))
    measurable = {"trajectory.tum", "hits.npz", "result.mcap"} <= set(document["outputs"])
    step = f"mavnav metrics {here}" if measurable else f"mavnav check {here} --gate 'tracking.lost==false'"
    rows = [*picture_row(directory, document, other), *page_row(directory)]
    return [*rows, ("run directory", str(directory)), ("next", step)]


def quality_rows(quality: dict[str, Any]) -> Rows:
    """Return the rows on ``map_quality`` of a document that a summary shows."""
    ghosts, revisits, support = quality["ghost_walls"], quality["revisits"], quality["support"]
    rows = [("ghost walls", "none")]
    if ghosts["count"]:
        rows = [
            (
                "ghost walls",
                f"{ghosts['count']}, {ghosts['length_m']:.1f} m, up to {ghosts['worst_offset_mm']:.0f} mm apart",
            )
        ]
    if revisits and revisits["nn_l_mm"] is not None:
        near = "" if revisits["nn_s_mm"] is None else f", neighbors {revisits['nn_s_mm']:.1f} mm"
        rows.append(("revisits", f"{revisits['nn_l_mm']:.1f} mm apart{near}"))
    rows.append(("straight walls", f"{support['wall_m']:.1f} m in the occupied cells of the map"))
    return rows + [("not meaningful", why) for why in quality["why"]]


def more_rows(quality: dict[str, Any]) -> Rows:
    """Return the other rows on ``map_quality``."""
    crisp, areas, support = quality["crispness"], quality["enclosed_areas"], quality["support"]
    rows = []
    if crisp["occupied_cells_per_m"] is not None:
        rows.append(
            ("crispness", f"{crisp['occupied_cells_per_m']:.0f} occupied cells per meter of wall (fewer is crisper)")
        )
    if crisp["entropy_bits"] is not None:
        rows.append(("entropy", f"{crisp['entropy_bits']:.3f} bits per hit cell (lower is crisper)"))
    if support["mapped_share"] is not None:
        rows.append(("accepted", f"{100 * support['mapped_share']:.1f} % of the scans"))
    if support["explained_share"] is not None:
        rows.append(("explained", f"{100 * support['explained_share']:.1f} % of what the laser saw lies on the map"))
    if quality["occupied_share"] is not None:
        rows.append(("occupied", f"{100 * quality['occupied_share']:.1f} % of the known cells"))
    return [
        *rows,
        ("corners", str(quality["corners"])),
        ("enclosed areas", f"{areas['count']}, {areas['area_m2']:.2f} m2"),
    ]


def reference_rows(reference: dict[str, Any] | None) -> Rows:
    """Return the rows on the comparison with references."""
    errors = reference or {}
    rows = []
    if errors.get("ate"):
        ate, rpe = errors["ate"], errors["rpe"]
        rows.append(("ATE, aligned", f"{ate['rmse_m'] / MM:.1f} mm rmse, {ate['max_m'] / MM:.1f} mm max"))
        if rpe["distance_rmse_m"] is not None:
            rows.append((f"RPE per {rpe['delta_m']:g} m", _relative(rpe)))
    if "map_distance" in errors and errors["map_distance"]["cells"]:
        d = errors["map_distance"]
        share = d["covered_share"]
        covered = f"{100 * share:.0f} % of the true walls mapped" if share is not None else "no wall at flight height"
        off = f"{d['mean_mm']:.0f} mm off, 95 % within {d['p95_mm']:.0f} mm"
        rows.append(("true map", f"{off}; {covered}, {d['alignment']}"))
    if "relations" in errors and errors["relations"]["all"]["scored"]:
        r = errors["relations"]["all"]
        mean = f"{r['translation_mean_m'] / MM:.1f} mm, {r['rotation_mean_deg']:.2f} deg"
        rows.append(("relations", f"{mean}; {r['scored']} of {r['relations']}"))
    return rows


def _relative(rpe: dict[str, Any]) -> str:
    if rpe["translation_rmse_m"] is None:
        return f"{rpe['distance_rmse_m'] / MM:.1f} mm of distance (the truth has no headings)"
    return f"{rpe['translation_rmse_m'] / MM:.1f} mm, {rpe['rotation_rmse_deg']:.2f} deg"
