"""The map drawn anew, from the poses that follow where loops were closed."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.loop_closure.detection import Loops, close_loops
from mavnav.slam.method import METHODS
from mavnav.slam.steps import Steps, tracked_way

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from mavnav.config.models import Config
    from mavnav.pose import Trajectory
    from mavnav.scan import Scan
    from mavnav.slam.method import Method
    from mavnav.slam.motion_model import Motion
    from mavnav.slam.steps import Step


def close(
    steps: Steps, log_scans: Callable[[], Iterable[Scan]], method: Method, motion: Motion, config: Config
) -> tuple[Steps, Method, Loops]:
    """Close loops and draw the map anew; all stays where there are none, or where the new map is no crisper.

    It stays as well where scans do not come, because the run is being stopped.
    """
    loops = close_loops(tracked_way(steps), partial(points_of, log_scans, steps, method), config)
    if loops.map_T_laser is None:
        return steps, method, loops
    fresh = METHODS[config.method](config)
    redrawn = Steps(redraw(log_scans(), steps, loops.map_T_laser, fresh, motion))
    if len(redrawn) < len(steps) or np.count_nonzero(fresh.grid.hits) >= np.count_nonzero(method.grid.hits):
        return steps, method, loops.dropped()
    return redrawn, fresh, loops


def points_of(
    log_scans: Callable[[], Iterable[Scan]], steps: Steps, method: Method, rows: list[int]
) -> Iterator[NDArray[np.float64]]:
    """Give the points (n, 2) of some tracked scans, numbered as in the trajectory; m, laser frame."""
    tracked = steps.column("index")[steps.column("tracked")].tolist()
    wanted = {tracked[row] for row in rows}
    return (method.match_points(scan).copy() for index, scan in enumerate(log_scans()) if index in wanted)


def redraw(
    scans: Iterable[Scan], steps: Steps, map_T_laser: Trajectory, method: Method, motion: Motion
) -> Iterator[Step]:
    """Draw a new map with every tracked scan at its corrected pose: a row of ``map_T_laser`` for each of them."""
    poses = iter([map_T_laser[row] for row in range(len(map_T_laser))])
    for step, scan in zip(steps, scans, strict=False):
        if not step.tracked:
            yield step
            continue
        pose = next(poses)
        method.insert(scan, pose, motion)
        motion = motion.moved_to(pose, step.stamp_ns) if motion.stamp_ns else motion.started_at(pose, step.stamp_ns)
        yield step._replace(match=step.match._replace(map_T_laser=pose))
