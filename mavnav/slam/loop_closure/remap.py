"""Loop closure of a track: correct the poses and rebuild the map from them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from mavnav.slam.loop_closure.detection import find_loops
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Steps, tracked_trajectory
from mavnav.slam.methods.registry import make_method

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from mavnav.pose import Pose, Trajectory
    from mavnav.scan import Scan
    from mavnav.slam.matching.motion_model import Motion
    from mavnav.slam.matching.steps import Step
    from mavnav.slam.methods.method import Method, Refiner
    from mavnav.slam.track import LogScans, Track


def close_loops(track: Track, refiner: Refiner) -> Track:
    """Close loops and rebuild the map; the track does not change without loops, or if the new map is no sharper.

    Nor does it change if the run is stopped early.
    """
    steps, config = track.steps, track.config
    if not refiner.builds_map or config.loop_closure != "auto":
        return track
    if track.on_step:
        track.on_step("close loops", 0)
    points = partial(points_of, track.log_scans, steps, refiner)
    loops = find_loops(tracked_trajectory(steps), points, partial(information_of, refiner), config)
    if loops.map_T_laser is None:
        return track.with_findings(loops=loops)
    fresh = make_method(config)
    rebuilt = Steps(rebuild(track.log_scans(), steps, loops.map_T_laser, fresh, track.motion))
    hits, hits_before = (np.count_nonzero(method.grid.hits) for method in (fresh, track.method))
    if len(rebuilt) < len(steps) or hits >= hits_before:
        return track.with_findings(loops=loops.refuse_all())
    return replace(track.with_findings(loops=loops), steps=rebuilt, method=fresh)


def points_of(log_scans: LogScans, steps: Steps, refiner: Refiner, rows: list[int]) -> Iterator[NDArray[np.float64]]:
    """Yield the match points (n, 2) of the tracked scans in these rows of the trajectory; m, laser frame."""
    tracked = steps.column("index")[steps.column("tracked")].tolist()
    wanted = {tracked[row] for row in rows}
    return (refiner.match_points(scan).copy() for index, scan in enumerate(log_scans()) if index in wanted)


def information_of(refiner: Refiner, points: NDArray[np.float64], map_T_laser: Pose) -> NDArray[np.float64]:
    """Return what the map shows of a pose by points (n, 2), (6,): `Refiner.observability`."""
    return refiner.observability(points, no_match(map_T_laser))[1]


def rebuild(
    scans: Iterable[Scan], steps: Steps, map_T_laser: Trajectory, method: Method, motion: Motion
) -> Iterator[Step]:
    """Insert every tracked scan into a new map at its corrected pose, a row of ``map_T_laser``; yield the steps."""
    poses = iter([map_T_laser[row] for row in range(len(map_T_laser))])
    for step, scan in zip(steps, scans, strict=False):
        if not step.tracked:
            yield step
            continue
        pose = next(poses)
        method.insert(scan, pose, motion)
        motion = motion.moved_to(pose, step.stamp_ns) if motion.stamp_ns else motion.started_at(pose, step.stamp_ns)
        yield step._replace(match=step.match._replace(map_T_laser=pose))
