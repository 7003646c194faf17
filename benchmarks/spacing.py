"""Errors of a track against the spacing of its beams: 36 to 1081 a turn, at three speeds, with and without odometry.

``python benchmarks/spacing.py`` prints a table of a drive of 8 m through a hall of 24 x 14 m: the largest error, m, and
the doubt of each run.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from mavnav.config.models import Config
from mavnav.pose import rigid_fit, transform_points
from mavnav.scan import LaserSpec
from mavnav.slam.pipeline import run_slam
from support.synthetic import along, box, drifting_odometry, record, room

BEAMS = (36, 48, 72, 120, 180, 360, 720, 1081)
SPEEDS_M_S = (0.2, 0.5, 1.0)
HALL = np.vstack((room(24.0, 14.0), box(8.0, 4.0, 3.0, 1.0), box(16.0, 9.5, 2.0, 1.5, 0.3)))
WAY = [(3.0, 7.0), (6.0, 8.0), (10.5, 6.5)]


def error_and_doubt(beams: int, speed_m_s: float, *, with_odometry: bool) -> tuple[float, float, float]:
    """Return the largest error after the best rigid motion, m, the share of scans with a pose, and the doubt."""
    spec = LaserSpec(-np.pi, 2 * np.pi / beams, beams, 0.05, 30.0, 0.0, 0.1)
    drive = record(HALL, along(WAY, speed_m_s=speed_m_s), spec, 0.01)
    odometry = drifting_odometry(drive.world_T_laser) if with_odometry else None
    run = run_slam(lambda: drive.scans, Config(), 0.1, odometry)
    tracked = np.isin(drive.map_T_laser.stamps_ns, run.trajectory.stamps_ns)
    truth, path = drive.map_T_laser.xyyaw[tracked, :2], run.trajectory.xyyaw[:, :2]
    off_m = np.hypot(*(transform_points(rigid_fit(path, truth), path) - truth).T)
    return float(off_m.max()), run.tracked_share, run.doubt.probability if run.doubt else np.nan


def main() -> None:
    """Print the table."""
    columns = [(speed, odometry) for odometry in (False, True) for speed in SPEEDS_M_S]
    print("beams  " + "  ".join(f"{speed} m/s{' odom' if odometry else '     '}" for speed, odometry in columns))
    for beams in BEAMS:
        cells = (error_and_doubt(beams, speed, with_odometry=odometry) for speed, odometry in columns)
        print(
            f"{beams:5}  "
            + "  ".join(f"{off:6.3f} {doubt:.2f}{'' if share == 1.0 else '*'}" for off, share, doubt in cells),
            flush=True,
        )


if __name__ == "__main__":
    main()
