"""Attitude and slices in run.json: what the scans were levelled by, and the maps by height."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Struct

from mavnav.logs.levelling import RecordedAttitude
from mavnav.mapping.occupancy_grid import OCCUPIED, occupancy
from mavnav.mapping.slices import Slice, slice_name
from mavnav.metrics.fields import Measured, number, text
from mavnav.metrics.wall_spread import PAPER_MIN_HITS, WallThicknessReport, wall_report
from mavnav.metrics.wall_thickness import wall_sections
from mavnav.units import DEG


class AttitudeSource(Struct, frozen=True):
    """What the scans were levelled by: roll, pitch and, if known, height of the laser."""

    topic: Annotated[str, text("topic of the attitude")]
    source: Annotated[str, text("pose: PoseStamped; odom: Odometry; imu: Imu, without height")]
    messages: Annotated[int, number("attitudes that are used")]
    tilt_median_deg: Annotated[Measured, number("half of the time the laser tilts less")]
    tilt_max_deg: Annotated[Measured, number("largest tilt of the laser")]
    height_min_m: Annotated[Measured, number("least height of the laser above the floor, null if unknown")]
    height_max_m: Annotated[Measured, number("greatest height of the laser above the floor, null if unknown")]
    ceiling_m: Annotated[Measured, number("height of the ceiling, null if none was found")]


class MapSlice(Struct, frozen=True):
    """The map of what was hit between two heights above the floor."""

    map: Annotated[str, text("file of the map, as map_server describes it")]
    middle_m: Annotated[float, number("height of its middle above the floor")]
    from_m: Annotated[float, number("height at which it begins")]
    to_m: Annotated[float, number("height at which it ends")]
    hits: Annotated[int, number("hits of all cells")]
    occupied: Annotated[int, number("occupied cells")]
    free: Annotated[int, number("free cells")]
    wall_thickness: WallThicknessReport


def attitude_source(attitude: RecordedAttitude) -> AttitudeSource:
    """Describe what the scans were levelled by."""
    tilts_deg, heights_m = attitude.tilt_rad / DEG, attitude.height_m
    known = attitude.has_heights
    return AttitudeSource(
        topic=attitude.topic,
        source=attitude.source,
        messages=len(attitude.stamps_ns),
        tilt_median_deg=float(np.median(tilts_deg)),
        tilt_max_deg=float(tilts_deg.max()),
        height_min_m=float(heights_m.min()) if known else np.nan,
        height_max_m=float(heights_m.max()) if known else np.nan,
        ceiling_m=attitude.ceiling_m,
    )


def map_slices(slices: tuple[Slice, ...]) -> list[MapSlice]:
    """Describe the slices, and measure their walls."""
    return [_map_slice(each) for each in slices]


def _map_slice(layer: Slice) -> MapSlice:
    grid, cells = layer.grid, occupancy(layer.grid)
    sections = {PAPER_MIN_HITS: wall_sections(grid.hits, grid.cell_m, PAPER_MIN_HITS)}
    published = wall_sections((cells == OCCUPIED).astype(np.uint16), grid.cell_m, 1)
    return MapSlice(
        map=f"{slice_name(layer)}.yaml",
        middle_m=layer.middle_m,
        from_m=layer.from_m,
        to_m=layer.to_m,
        hits=int(grid.hits.sum(dtype=np.int64)),
        occupied=int((cells == OCCUPIED).sum()),
        free=int((cells == 0).sum()),
        wall_thickness=wall_report(sections, published, None, grid.cell_m),
    )
