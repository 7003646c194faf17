"""Rows of a summary table on the quality of a map; a number that is not known has no row."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mavnav.units import MM

if TYPE_CHECKING:
    from mavnav.commands.terminal import Rows


def wall_rows(document: dict[str, Any]) -> Rows:
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


def spread_text(spread: dict[str, Any]) -> str:
    """Describe the wall thickness, and the length and share of the walls that it was measured on."""
    if spread["median_mm"] is None:
        return "no straight wall to measure"
    share = f"{spread['length_m']:.1f} m, {100 * spread['measured_share']:.0f} % of the straight walls in the scans"
    return f"{_thickness(spread)} ({share})"


def _thickness(walls: dict[str, Any]) -> str:
    return f"median {walls['median_mm']:.0f} mm, p95 {walls['p95_mm']:.0f} mm"


def quality_rows(quality: dict[str, Any]) -> Rows:
    """Yield the rows on ``map_quality`` of a document that a summary shows."""
    ghosts, revisits = quality["ghost_walls"], quality["revisits"]
    apart = f"{ghosts['length_m']:.1f} m, up to {ghosts['worst_offset_mm']:.0f} mm apart" if ghosts["count"] else ""
    yield "ghost walls", f"{ghosts['count']}, {apart}" if apart else "none"
    if revisits and revisits["nn_l_mm"] is not None:
        near = "" if revisits["nn_s_mm"] is None else f", neighbors {revisits['nn_s_mm']:.1f} mm"
        yield "revisits", f"{revisits['nn_l_mm']:.1f} mm apart{near}"
    for why in quality["why"]:
        yield "not meaningful", why


def more_rows(quality: dict[str, Any]) -> Rows:
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


def reference_rows(reference: dict[str, Any] | None) -> Rows:
    """Yield the rows on the comparison with references."""
    errors = reference or {}
    if errors.get("ate"):
        ate, rpe = errors["ate"], errors["rpe"]
        yield "ATE, aligned", f"{ate['rmse_m'] / MM:.1f} mm rmse, {ate['max_m'] / MM:.1f} mm max"
        if rpe["distance_rmse_m"] is not None:
            yield f"RPE per {rpe['delta_m']:g} m", _relative(rpe)
    if "map_distance" in errors and (d := errors["map_distance"])["cells"]:
        share = d["covered_share"]
        covered = f"{100 * share:.0f} % of the true walls mapped" if share is not None else "no wall at flight height"
        yield "true map", f"{d['mean_mm']:.0f} mm off, 95 % within {d['p95_mm']:.0f} mm; {covered}, {d['alignment']}"
    if "relations" in errors and (r := errors["relations"]["all"])["scored"]:
        mean = f"{r['translation_mean_m'] / MM:.1f} mm, {r['rotation_mean_deg']:.2f} deg"
        yield "relations", f"{mean}; {r['scored']} of {r['relations']}"


def _relative(rpe: dict[str, Any]) -> str:
    if rpe["translation_rmse_m"] is None:
        return f"{rpe['distance_rmse_m'] / MM:.1f} mm of distance (the truth has no headings)"
    return f"{rpe['translation_rmse_m'] / MM:.1f} mm, {rpe['rotation_rmse_deg']:.2f} deg"
