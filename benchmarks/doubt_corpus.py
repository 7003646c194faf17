"""The runs to which the doubt is fitted: recorded logs with disturbances, and simulated scenes with ground truth.

The name of a run is ``LOG/KIND/LEVEL/SEED``; odd seeds have the odometry of the log, if it has any.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.pose import Pose, Trajectory, rigid_fit, transform_points
from mavnav.scan import LaserSpec, Scan
from mavnav.simulation.mission import fly
from mavnav.simulation.world.scenario_file import load_scenario
from mavnav.slam import pipeline
from mavnav.slam.result import SlamResult
from mavnav.units import DEG

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.synthetic import (
    NOTHING,
    URG_04LX,
    along,
    box,
    corridor_with_rooms,
    drifting_odometry,
    furnished_rooms,
    polyline,
    record,
    room,
)

LOGS = {
    "ccny_demo": ("ccny_demo/ccny_demo.mcap", None, None),
    "lego_robot4": ("lego_robot4/lego_robot4.mcap", None, None),
    "urg_exp1": ("urg_exp1/urg_exp1.mcap", 0.0, 40.0),
    "urg_exp1b": ("urg_exp1/urg_exp1.mcap", 40.0, 80.0),
    "turtlebot4_mac2": ("turtlebot4_mac2/turtlebot4_mac2_ros2", None, None),
    "slambot_rplidar": ("slambot_rplidar/slambot_rplidar.mcap", None, None),
    "fr079": ("fr079/fr079.mcap", 0.0, 60.0),
    "fr079b": ("fr079/fr079.mcap", 300.0, 350.0),
    "fr079c": ("fr079/fr079.mcap", 600.0, 650.0),
    "kidnap_expt09": ("field/kidnap_expt09/kidnap_expt09.bag", 0.0, 40.0),
    "wean_1": ("field/wean_1/wean_1.log.gz", 0.0, 60.0),
    "wean_1b": ("field/wean_1/wean_1.log.gz", 70.0, 130.0),
    "wean_4": ("field/wean_4/wean_4.log.gz", None, None),
    "neato_first": ("field/neato_first/neato_first.bag", None, None),
    "neato_wall": ("field/neato_wall/neato_wall.bag", None, None),
    "neato_square": ("field/neato_square/neato_square.bag", None, None),
    "rss26_t1r": ("field/rss26_t1r/rss26_t1r.db3", None, None),
    "rss26_loopfast": ("field/rss26_loopfast/rss26_loopfast.db3", None, None),
    "carto_hokuyo": ("field/carto_hokuyo/carto_hokuyo.bag", None, None),
    "lidarme": ("field/lidarme/lidarme.bag", None, None),
    "selfdrv_nav": ("field/selfdrv_nav/selfdrv_nav.db3", None, None),
    "neato_person": ("field/neato_person/neato_person.db3", None, None),
    **{
        name: (f"reports/{name}/log.mcap", None, None)
        for name in (
            "ghost_walls_on_a_right_map",
            "hall_360_beams_slow_odom",
            "mounting_jitters_in_tf",
            "odometry_reset_near_start",
            "sparse_72_beams_odom",
            "sparse_90_beams",
            "warehouse_360_beams",
        )
    },
}
"""Name of a log -> its file in the folder of logs, and start and end of the part that is used, s.

The track of the whole is the reference, or ``truth.tum`` beside the file.
"""

WRONG_LOGS = {
    "kev_urg": ("kev_urg/kev_urg.bag", None, None),
    "ydlidar_194415": ("ydlidar_194415/ydlidar_194415.mcap", None, None),
    "gruhl_laser": ("field/gruhl_laser/gruhl_laser.bag", None, None),
}
"""Recordings of which no track is right: tilted by hand, too fast, and an open field."""

LEVELS: dict[str, tuple[float, ...]] = {
    "none": (0,),
    "drop": (0.2, 0.35, 0.5),
    "every": (2, 4, 8, 12),
    "cut": (1.0, 2.0, 3.0),
    "noise": (0.01, 0.02),
    "mask": (0, 1, 2),
    "far": (0.5, 0.75),
    "short": (0.1,),
}
"""Kinds of disturbance with their levels: share of dropped scans; keep every n-th scan; length of two gaps, s; standard
deviation of range noise, m; index of the masked third of the beams (with a tenth of the scans dropped); quantile of the
ranges that are kept; share of ranges that something in front shortens."""


class Case(Struct, frozen=True):
    """A run: its scans, period, odometry and reference poses."""

    scans: list[Scan]
    period_s: float
    odometry: Trajectory | None
    reference: Trajectory
    base_T_laser: Pose | None = None

    def track(self) -> SlamResult:
        """Return the track of the scans."""
        stamps_ns = np.array([scan.stamp_ns for scan in self.scans])
        options = {"base_T_laser": self.base_T_laser, "scans_ns": stamps_ns}
        return pipeline.run_slam(lambda: self.scans, Config(), self.period_s, self.odometry, **options)


def disturbed(scans: list[Scan], period_s: float, kind: str, level: float, seed: int) -> tuple[list[Scan], float]:
    """Return the disturbed scans, and their period in s."""
    rng = np.random.default_rng([seed, int(1000 * level), sorted(LEVELS).index(kind)])
    if kind == "drop":
        return [s for s, keep in zip(scans, rng.random(len(scans)) >= level, strict=True) if keep], period_s
    if kind == "every":
        return scans[int(rng.integers(level)) :: int(level)], period_s * level
    if kind == "cut":
        starts = scans[0].stamp_ns + rng.random(2) * (scans[-1].stamp_ns - scans[0].stamp_ns)
        return [s for s in scans if not any(0 <= s.stamp_ns - a < 1e9 * level for a in starts)], period_s
    if kind == "noise":
        return [changed(s, s.ranges_m + rng.normal(0.0, level, len(s.ranges_m))) for s in scans], period_s
    if kind == "mask":
        kept = [s for s in scans if rng.random() >= 0.1]
        return [changed(s, masked(s.ranges_m, int(level))) for s in kept], period_s
    if kind == "far":
        far_m = float(np.nanquantile(np.concatenate([s.ranges_m for s in scans[::10]]), level + 0.05 * rng.random()))
        return [changed(s, np.where(s.ranges_m <= far_m, s.ranges_m, np.nan)) for s in scans], period_s
    if kind == "short":
        return [changed(s, shortened(s.ranges_m, level, rng)) for s in scans], period_s
    return list(scans), period_s


def changed(scan: Scan, ranges_m: np.ndarray) -> Scan:
    """Return a scan with other ranges."""
    return replace(scan, ranges_m=ranges_m)


def masked(ranges_m: np.ndarray, third: int) -> np.ndarray:
    """Return ranges without a third of the beams."""
    out, n = ranges_m.copy(), len(ranges_m)
    out[third * n // 3 : (third + 1) * n // 3] = np.nan
    return out


def recorded_names(logs: tuple[str, ...] = tuple(LOGS)) -> list[str]:
    """Return the names of all runs of recorded logs."""
    return [
        f"{log}/{kind}/{level}/{seed}"
        for log in logs
        for kind, levels in LEVELS.items()
        for level in levels
        for seed in range(2)
    ]


@lru_cache(maxsize=8)
def read(folder: Path, log: str, odom: str) -> Case:
    """Read a log, without a reference."""
    file, start_s, end_s = (LOGS | WRONG_LOGS)[log]
    topic = "/scan" if log.startswith("neato") else None
    opened = open_log(folder / file, odom=odom, start_s=start_s, end_s=end_s, topic=topic)
    return Case(list(opened.scans()), opened.period_s, opened.odom_T_laser, Trajectory.of([], []), opened.base_T_laser)


def recorded(folder: Path, name: str) -> Case:
    """Return a run of a recorded log; those of odd seeds have its odometry, if there is any."""
    log, kind, level, seed = name.split("/")
    case = read(folder, log, "auto" if int(seed) % 2 else "off")
    scans, period_s = disturbed(case.scans, case.period_s, kind, float(level), int(seed))
    return replace(case, scans=scans, period_s=period_s, reference=undisturbed(folder, log))


def shortened(ranges_m: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Return ranges of which a random share ends anywhere before."""
    shares = np.where(rng.random(len(ranges_m)) < share, rng.random(len(ranges_m)), 1.0)
    return ranges_m * shares


SHORT = LaserSpec(URG_04LX.angle_min_rad, URG_04LX.angle_step_rad, 681, 0.02, 4.0, 0.0, 0.1)
SCENES = (
    "plain24",
    "doors24",
    "plain80",
    "doors80",
    "hall",
    "round",
    "wall",
    "rooms",
    "square",
    "boxed",
    "cart",
    "trolley",
)
PUSHED = ("cart", "trolley")
FAR = LaserSpec(-135 * DEG, 0.75 * DEG, 361, 0.05, 10.0)
HARD = ("plain24", "plain80", "hall", "round", *PUSHED)
"""Scenes with an unobservable direction, or with a cart that moves ahead of the laser."""


def scene_names(seeds: int = 4, more: int = 10) -> list[str]:
    """Return the names of all simulated runs; ``odo`` has drifting odometry. Hard scenes have more seeds."""
    kinds = {scene: {"plain": more if scene in HARD else seeds, "every3": seeds, "odo": seeds} for scene in SCENES}
    return [f"sim-{scene}/{kind}/0/{k}" for scene in SCENES for kind, n in kinds[scene].items() for k in range(n)]


def simulated(name: str) -> Case:
    """Return a run through a simulated scene."""
    scene, kind, _, seed = name.removeprefix("sim-").split("/")
    rng = np.random.default_rng([int(seed), SCENES.index(scene)])
    walls, way = scenery(scene, rng)
    speed = float(rng.uniform(0.4, 1.0)) if not scene.endswith("80") else 1.5
    path = along(way, speed_m_s=speed, turn_rad_s=float(rng.uniform(0.6, 2.0)))
    spec, noise = FAR if scene in PUSHED else SHORT, float(rng.uniform(0.003, 0.015))
    carried = box(rng.uniform(1.5, 4.5), rng.uniform(-0.2, 0.2), 1.0, rng.uniform(0.2, 1.6)) if spec is FAR else NOTHING
    drive = record(walls, path, spec, noise, int(seed), carried)
    odometry = drifting_odometry(drive.world_T_laser, int(seed)) if kind == "odo" else None
    scans, period_s = (drive.scans[::3], 0.3) if kind == "every3" else (drive.scans, 0.1)
    seen = [scan for scan in scans if np.isfinite(scan.ranges_m).any()]  # readers of logs skip empty scans
    return Case(seen, period_s, odometry, drive.map_T_laser)


def scenery(scene: str, rng: np.random.Generator) -> tuple[np.ndarray, list[tuple[float, float]]]:
    """Return the walls of a scene, and the waypoints of a path through it."""
    jitter = [(float(a), float(b)) for a, b in rng.uniform(-0.15, 0.15, (12, 2))]
    if scene.startswith(("plain", "doors")):
        length = float(scene[-2:])
        walls = [polyline((0, -1), (length, -1), (length, 1), (0, 1), closed=True)]
        places = np.arange(1.5, length - 1.0, 2.5) if scene.startswith("doors") else np.zeros(0)
        walls += [
            box(x + rng.uniform(-0.8, 0.8), rng.choice((-0.95, 0.95)), rng.uniform(0.3, 0.9), 0.3) for x in places
        ]
        end = length - 1.5 if length < 50 else 40.0
        return np.vstack(walls), [(1.0, jitter[0][1]), (end / 2, jitter[1][1]), (end, jitter[2][1])]
    if scene == "hall":
        return polyline((0, 0), (14, 0), (14, 12), (0, 12), closed=True), [(2 + jitter[0][0], 2), (7, 6), (11, 9)]
    if scene == "round":
        ring = [(2.5 * np.cos(a), 2.5 * np.sin(a)) for a in np.arange(0.0, 2 * np.pi, np.pi / 60)]
        return polyline(*ring, closed=True), [(-0.6, jitter[0][1]), (0.5, 0.4 + jitter[1][1]), (0.2, -0.7)]
    if scene == "wall":
        return polyline((-20, 1), (20, 1)), [(0.0, -1.0), (3.0, -1.0 + jitter[0][1])]
    if scene == "square":
        return room(3.0, 3.0), [(0.8, 0.8), (2.2, 0.8 + jitter[0][1]), (2.1, 2.2), (0.8, 2.1), (0.9, 0.9)]
    if scene == "boxed":
        walls = [
            room(7.0, 5.0),
            *(box(*rng.uniform((1, 1), (6, 4)), *rng.uniform(0.2, 0.6, 2), rng.uniform(0, 3)) for _ in range(4)),
        ]
        return np.vstack(walls), [(0.5, 0.5), (6.4, 0.5 + jitter[0][1] / 3), (6.5, 4.4), (0.5, 4.5), (0.5, 0.9)]
    if scene == "cart":
        return corridor_with_rooms(), [(2.0 + jitter[0][0], jitter[0][1]), (14.0, jitter[1][1])]
    return furnished_rooms(), [(0.8, 0.7), (2.8 + jitter[0][0], 0.7), (4.9, 0.7), (5.2, 2.2), (4.65, 3.4), (4.65, 5.0)]


MISSION = "mission-"
MISSIONS = (
    "corner",
    "corridor",
    "complex",
    "curved",
    "loop",
    "u_trap",
    "hallway",
    "hall",
    "dead_end",
    "doorway",
    "ring",
)


def mission_names(seeds: int = 8) -> list[str]:
    """Return the names of all missions."""
    return [f"{MISSION}{scenario}/fly/0/{seed}" for scenario in MISSIONS for seed in range(seeds)]


WINDOWS_S = (2.0, 10.0, 60.0)
"""Lengths of the windows over which a track is compared with the truth."""


def largest_errors(
    poses: Trajectory, reference: Trajectory, windows_s: Sequence[float] = WINDOWS_S[:2]
) -> tuple[float, float]:
    """Return the largest error of the relative motion over windows: position in m, heading in deg."""
    rows = np.searchsorted(reference.stamps_ns, poses.stamps_ns)
    same = (rows < len(reference)) & (reference.stamps_ns[np.minimum(rows, len(reference) - 1)] == poses.stamps_ns)
    stamps, mine, true = poses.stamps_ns[same], poses.xyyaw[same], reference.xyyaw[rows[same]]
    off_m = off_deg = 0.0
    for window_s in windows_s:
        end = np.minimum(np.searchsorted(stamps, stamps + int(window_s * 1e9)), len(stamps) - 1)
        for k, m in enumerate(end.tolist()):
            gap = Pose(*true[k]).between(Pose(*true[m])).between(Pose(*mine[k]).between(Pose(*mine[m])))
            off_m, off_deg = max(off_m, gap.distance_m), max(off_deg, abs(gap.yaw_rad) / DEG)
    return off_m, off_deg


def largest_offset_m(poses: Trajectory, reference: Trajectory) -> float:
    """Return the largest error of the positions after the best rigid motion, m."""
    same = np.isin(poses.stamps_ns, reference.stamps_ns)
    mine = poses.xyyaw[same, :2]
    true = reference.xyyaw[np.searchsorted(reference.stamps_ns, poses.stamps_ns[same]), :2]
    return float(np.hypot(*(transform_points(rigid_fit(mine, true), mine) - true).T).max()) if len(mine) > 1 else 0.0


INTEL = "intel_sparse"
STRETCH = 130
"""Number of key frames in a part of the sparse log."""


def sparse(folder: Path, name: str) -> Case:
    """Return a part of a log of key frames, too sparse for tracking, with the poses of another SLAM system."""
    first = int(name.split("/")[3]) * STRETCH
    log = open_log(folder / INTEL / f"{INTEL}.mcap", odom="off")
    scans = list(log.scans())
    truth = at_scans(scans, folder / INTEL / "groundtruth.tum")
    return Case(scans[first : first + STRETCH], log.period_s, None, truth)


def at_scans(scans: list[Scan], file: Path) -> Trajectory:
    """Return the poses of a TUM file that are closest in time to scans."""
    stamps, rows = np.array([scan.stamp_ns for scan in scans]), np.loadtxt(file)
    at = [int(np.abs(rows[:, 0] - stamp * 1e-9).argmin()) for stamp in stamps.tolist()]
    yaws = 2.0 * np.arctan2(rows[at, 6], rows[at, 7])
    return Trajectory(stamps, np.column_stack((rows[at, 1], rows[at, 2], yaws)))


@cache
def undisturbed(folder: Path, log: str) -> Trajectory:
    """Return the truth of a log, or the track of the undisturbed log, with its odometry."""
    case, truth = read(folder, log, "auto"), (folder / (LOGS | WRONG_LOGS)[log][0]).with_name("truth.tum")
    return at_scans(case.scans, truth) if truth.exists() else case.track().trajectory


def case_of(folder: Path, name: str) -> Case:
    """Return a run by its name."""
    if name.startswith("sim-"):
        return simulated(name)
    return sparse(folder, name) if name.startswith(INTEL) else recorded(folder, name)


def flown(name: str) -> tuple[SlamResult, Trajectory]:
    """Fly a mission; return the result of SLAM, and the true poses."""
    scenario, _, _, seed = name.removeprefix(MISSION).split("/")
    flight = fly(load_scenario(scenario, [], {"seed": int(seed)}))
    return flight.slam, flight.map_T_laser


def every_name() -> Iterator[str]:
    """Yield the names of all runs."""
    yield from (f"{log}/none/0/{seed}" for log in WRONG_LOGS for seed in range(2))
    yield from recorded_names()
    yield from (f"{INTEL}/none/0/{stretch}" for stretch in range(7))
    yield from scene_names()
    yield from mission_names()
