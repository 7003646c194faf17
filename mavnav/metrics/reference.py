"""Errors of a run against references besides its log: the section ``reference`` of run.json.

A true trajectory gives absolute errors, with and without alignment by a rigid motion, and relative ones. Relations are
true motions between two times, the benchmark of Kuemmerle et al. 2009 ("On measuring the accuracy of SLAM algorithms",
Autonomous Robots 27): it needs no common frame, and drift only affects relations that span it. True walls give the
distance of the map from them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Final

import numpy as np
from msgspec import Struct, field
from msgspec.structs import asdict
from numpy.typing import NDArray

from mavnav.metrics.fields import OPTIONAL, Measured, number
from mavnav.pose import MAX_GAP_NS, Trajectory, between, motions, nearest_rows, rigid_fit, transform_points
from mavnav.units import DEG, MM

Array = NDArray[np.float64]

GAP_PERIODS: Final = 2.5
"""A gap between compared poses is longer than `MAX_GAP_NS` and than this many median steps; no stretch spans it."""

DELTA_M: Final = 1.0
"""Length of the stretches of the estimated path for relative errors."""

NO_TURN_RAD: Final = 1e-6
"""A truth whose headings all lie within this angle has none: quaternions of a constant heading are rounded."""

LEAST_POSES: Final = 3
"""Minimum number of poses with a truth: fewer fit any truth, or nearly so, after the best rigid motion."""

TOLERANCE_NS: Final = 100_000_000
"""Largest time between a relation and the nearest pose; farther away, the relation is missing."""

LOOP_NS: Final = 20_000_000_000
"""Time above which a relation is a loop; the others are sequential."""

COVERED_M: Final = 0.1

ATE: Final = "absolute trajectory error against the truth"


class AbsoluteError(Struct, frozen=True):
    """Absolute trajectory error (Sturm et al. 2012) over ``poses`` positions, in metres; NaN without poses."""

    poses: int
    rmse_m: float
    median_m: float
    max_m: float


class AlignedError(Struct, frozen=True):
    """Absolute trajectory error against the truth (Sturm et al. 2012), after the best rigid motion."""

    alignment: str
    poses: Annotated[int, number("poses that have a truth")]
    rmse_m: Annotated[Measured, number(f"{ATE}, root mean square, after alignment", title="ATE", better="lower")]
    median_m: Annotated[Measured, number("median of the errors, after alignment")]
    max_m: Annotated[Measured, number("largest of the errors, after alignment")]
    share: Annotated[float, number("part of the poses that have a truth")]
    unaligned_rmse_m: Annotated[Measured, number("root mean square of the errors, without alignment")]


class RelativeError(Struct, frozen=True):
    """Relative pose error (Sturm et al. 2012) over stretches of the estimated path without a gap; null without one.

    Translation and rotation are null as well if the truth has no headings.
    """

    pairs: Annotated[int, number("stretches of the path, without a gap, that were compared")]
    delta_m: Annotated[float, number("length of a stretch")]
    translation_rmse_m: Annotated[Measured, number("root mean square error of the motion over a stretch")]
    rotation_rmse_deg: Annotated[Measured, number("root mean square error of the turn over a stretch")]
    distance_rmse_m: Annotated[
        Measured, number("root mean square error of the distance between the ends of a stretch; it needs no headings")
    ]


class Relations(Struct, frozen=True):
    """``stamps_ns`` (n, 2): two times; ``xyyaw`` (n, 3): the second pose in the frame of the first, m, m, rad."""

    stamps_ns: NDArray[np.int64]
    xyyaw: Array


class RelationErrors(Struct, frozen=True):
    """Errors over the relations that have poses at both times; null without one."""

    relations: Annotated[int, number("relations given")]
    scored: Annotated[int, number("relations with poses at both times")]
    share: Annotated[Measured, number("part of the relations that is scored; a short trajectory misses some")]
    translation_mean_m: Annotated[Measured, number("mean error of the translation")]
    translation_std_m: Annotated[Measured, number("standard deviation of the translation's error")]
    rotation_mean_deg: Annotated[Measured, number("mean error of the rotation")]
    rotation_std_deg: Annotated[Measured, number("standard deviation of the rotation's error")]


class TrueMap(Struct, frozen=True):
    """The true walls in the map frame.

    ``distance_m`` returns the distance of points (n, 2) to the nearest wall, (n,) in m. ``xy_m`` (m, 2) are points
    along all walls. ``alignment`` names how they were transformed to the map frame. ``segments_map`` (k, 4) and
    ``arcs_map`` (l, 5) are the walls for drawing, as in `Truth`; a map file has none.
    """

    distance_m: Callable[[Array], Array]
    xy_m: Array
    alignment: str
    segments_map: Array = field(default_factory=lambda: np.zeros((0, 4)))
    arcs_map: Array = field(default_factory=lambda: np.zeros((0, 5)))


class MapDistance(Struct, frozen=True):
    """Distances of the occupied cells to the nearest true wall; null without any."""

    alignment: str
    cells: Annotated[int, number("occupied cells")]
    mean_mm: Annotated[Measured, number("how far the walls lie from the true ones", title="map error", better="lower")]
    median_mm: Annotated[Measured, number("half of the occupied cells are not farther from a true wall")]
    p95_mm: Annotated[Measured, number("95 % of the occupied cells are not farther from a true wall")]
    max_mm: Annotated[Measured, number("distance of the farthest occupied cell from a true wall")]
    covered_share: Annotated[
        Measured,
        number("part of the true walls that has an occupied cell within 0.1 m; null if no wall is at flight height"),
    ]


class Reference(Struct, frozen=True):
    """Errors against references besides the log; a key for each reference that was given.

    ``ate`` and ``rpe`` are null if too few poses have a truth.
    """

    ate: AlignedError | None = OPTIONAL
    rpe: RelativeError | None = OPTIONAL
    map_distance: MapDistance = OPTIONAL
    relations: dict[str, RelationErrors] = OPTIONAL


def pose_errors(trajectory: Trajectory, truth: Trajectory) -> tuple[AlignedError, RelativeError] | tuple[None, None]:
    """Return the absolute and the relative errors of a trajectory; None if fewer than `LEAST_POSES` have a truth."""
    estimate, true = associate(trajectory, truth)
    if len(estimate) < LEAST_POSES:
        return None, None
    xy_m, true_xy_m = estimate.xyyaw[:, :2], true.xyyaw[:, :2]
    aligned = AlignedError(
        alignment="best rigid motion",
        **asdict(absolute_error(xy_m, true_xy_m)),
        share=len(estimate) / len(trajectory),
        unaligned_rmse_m=absolute_error(xy_m, true_xy_m, aligned=False).rmse_m,
    )
    return aligned, relative_error(estimate, true)


def absolute_error(estimate_xy_m: Array, truth_xy_m: Array, *, aligned: bool = True) -> AbsoluteError:
    """Return the errors of positions (n, 2), m; ``aligned``: after the best rigid motion."""
    n = len(estimate_xy_m)
    if n == 0:
        return AbsoluteError(0, np.nan, np.nan, np.nan)
    if aligned:
        estimate_xy_m = transform_points(rigid_fit(estimate_xy_m, truth_xy_m), estimate_xy_m)
    error = np.hypot(*(estimate_xy_m - truth_xy_m).T)
    return AbsoluteError(n, _rms(error), float(np.median(error)), float(error.max()))


def relative_error(estimate: Trajectory, truth: Trajectory) -> RelativeError:
    """Return the errors of motions over stretches of the path; poses at the same times, each in its own frame."""
    stretches = _stretches(estimate)
    if not len(stretches):
        return RelativeError(0, DELTA_M, np.nan, np.nan, np.nan)
    moved, should = (motions(path.xyyaw, *stretches.T) for path in (estimate, truth))
    error = between(should, moved)
    apart = np.hypot(*moved[:, :2].T) - np.hypot(*should[:, :2].T)
    yaw_rad = truth.xyyaw[:, 2]
    turned = (yaw_rad - yaw_rad[0] + np.pi) % (2.0 * np.pi) - np.pi
    headed = bool(np.ptp(turned) > NO_TURN_RAD)
    errors = (_rms(np.hypot(*error[:, :2].T)), _rms(error[:, 2]) / DEG) if headed else (np.nan, np.nan)
    return RelativeError(len(stretches), DELTA_M, *errors, _rms(apart))


def associate(estimate: Trajectory, truth: Trajectory) -> tuple[Trajectory, Trajectory]:
    """Return the estimated poses that have a truth, and the true ones at the same times.

    The truth is interpolated; estimates before it, after it and in its longer gaps are left out.
    """
    true_poses = [(k, truth.at(int(stamp_ns), MAX_GAP_NS)) for k, stamp_ns in enumerate(estimate.stamps_ns)]
    rows = [k for k, pose in true_poses if pose is not None]
    stamps_ns = estimate.stamps_ns[rows]
    true = Trajectory.of(stamps_ns.tolist(), [pose for _, pose in true_poses if pose is not None])
    return Trajectory(stamps_ns, estimate.xyyaw[rows]), true


def position_errors(estimate: Trajectory, truth: Trajectory, *, aligned: bool) -> Array:
    """Return the position error of every pose, (n,), m, after alignment if ``aligned``; NaN without a truth."""
    true_poses = [truth.at(int(stamp_ns), MAX_GAP_NS) for stamp_ns in estimate.stamps_ns]
    true_xy_m = np.array([(np.nan, np.nan) if pose is None else pose[:2] for pose in true_poses]).reshape(-1, 2)
    known, xy_m = np.isfinite(true_xy_m[:, 0]), estimate.xyyaw[:, :2]
    if aligned and known.any():
        xy_m = transform_points(rigid_fit(xy_m[known], true_xy_m[known]), xy_m)
    return np.asarray(np.hypot(*(xy_m - true_xy_m).T))


def _stretches(path: Trajectory) -> NDArray[np.intp]:
    """Return first and last row, (n, 2), of stretches of a path: each of `DELTA_M` or just above, without a gap."""
    steps_ns = np.diff(path.stamps_ns)
    longest_ns = max(MAX_GAP_NS, GAP_PERIODS * float(np.median(steps_ns))) if len(steps_ns) else MAX_GAP_NS
    stretches: list[tuple[int, int]] = []
    start, walked_m = 0, 0.0
    steps_m = np.hypot(*np.diff(path.xyyaw[:, :2], axis=0).T)
    for k, (step_m, step_ns) in enumerate(zip(steps_m, steps_ns, strict=True), start=1):
        if step_ns > longest_ns:
            start, walked_m = k, 0.0
            continue
        walked_m += float(step_m)
        if walked_m >= DELTA_M:
            stretches.append((start, k))
            start, walked_m = k, 0.0
    return np.array(stretches, np.intp).reshape(-1, 2)


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def relation_errors(relations: Relations, trajectory: Trajectory) -> dict[str, RelationErrors]:
    """Return the errors of a trajectory of the laser: over ``all`` relations, ``sequential`` ones and ``loops``."""
    loop = np.abs(np.diff(relations.stamps_ns, axis=1)[:, 0]) > LOOP_NS
    kinds = {"all": np.full(len(loop), fill_value=True), "sequential": ~loop, "loops": loop}
    if not len(trajectory):
        return {name: _errors(np.zeros((0, 3)), int(kind.sum())) for name, kind in kinds.items()}
    rows = nearest_rows(trajectory.stamps_ns, relations.stamps_ns)
    gaps_ns = np.abs(relations.stamps_ns - trajectory.stamps_ns[rows])
    error = between(relations.xyyaw, motions(trajectory.xyyaw, *rows.T))
    scored = (gaps_ns < TOLERANCE_NS).all(axis=1)
    return {name: _errors(error[kind & scored], int(kind.sum())) for name, kind in kinds.items()}


def _errors(error: Array, relations: int) -> RelationErrors:
    n, sizes = len(error), (np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2]) / DEG)
    spreads = [float(value) for size in sizes for value in (size.mean(), size.std())] if n else [np.nan] * 4
    return RelationErrors(relations, n, n / relations if relations else np.nan, *spreads)


def map_distance(occupied_xy_m: Array, truth: TrueMap) -> MapDistance:
    """Return the distances of occupied cells with centres (n, 2), map frame, m, to the true walls."""
    from scipy.spatial import cKDTree  # noqa: PLC0415  takes 0.3 s to load

    n = len(occupied_xy_m)
    if n == 0:
        return MapDistance(truth.alignment, 0, np.nan, np.nan, np.nan, np.nan, 0.0)
    distance_mm = truth.distance_m(occupied_xy_m) / MM
    gap_m, _ = cKDTree(occupied_xy_m).query(truth.xy_m)
    median_mm, p95_mm = np.quantile(distance_mm, (0.5, 0.95)).tolist()
    return MapDistance(
        alignment=truth.alignment,
        cells=n,
        mean_mm=float(distance_mm.mean()),
        median_mm=median_mm,
        p95_mm=p95_mm,
        max_mm=float(distance_mm.max()),
        covered_share=float((gap_m <= COVERED_M).mean()) if len(gap_m) else np.nan,
    )
