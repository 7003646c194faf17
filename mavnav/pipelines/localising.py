"""Localization in a known map: reading the map before a replay, and what run.json says of it afterwards."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavnav.errors import UsageError
from mavnav.outputs.documents.run_json import FoundPose, Localisation, StartPose
from mavnav.slam.methods.registry import LOCALIZERS
from mavnav.units import DEG

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.pose import Pose
    from mavnav.slam.matching.prior_map import PriorMap
    from mavnav.slam.result import SlamResult


def known_map(path: Path | None, start_pose: Pose | None, method: str) -> PriorMap | None:
    """Read the map to localize in, a map_server YAML file or the one in a run directory; raises UsageError.

    ``start_pose`` is about where in it the laser begins. Returns None without a path.
    """
    if path is None:
        return None
    if method not in LOCALIZERS:
        advice = f"use --method {' or '.join(LOCALIZERS)}"
        raise UsageError(f"--map: method {method} makes a map of its own; {advice}")
    from mavnav.ground_truth.map_file import read_map  # noqa: PLC0415  few runs need them
    from mavnav.slam.matching.prior_map import prior_map_of  # noqa: PLC0415

    file = read_map(path / "map.yaml" if path.is_dir() else path)
    known = prior_map_of(file.grid, file.map_T_grid, start_pose)
    if not len(known.walls_xy_m):
        raise UsageError(f"{path}: the map has no occupied cell; name a map with walls")
    return known


def localisation(path: Path, start_pose: Pose | None, outcome: SlamResult) -> Localisation:
    """Return the section of run.json on localization in a known map: the given start pose, and the one found."""
    first = next((step for step in outcome.steps if step.tracked), None)
    pose = first and first.match.map_T_laser
    return Localisation(
        map=str(path),
        start_pose=start_pose and StartPose(start_pose.x_m, start_pose.y_m, start_pose.yaw_rad / DEG),
        found=FoundPose(first.index, pose.x_m, pose.y_m, pose.yaw_rad / DEG) if first and pose else None,
    )
