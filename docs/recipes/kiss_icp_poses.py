"""Run KISS-ICP on a log of a planar laser: kiss_icp_poses.py LOG OUT.tum [VOXEL_M]; pip install mavnav kiss-icp."""

import sys
from pathlib import Path

import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.kiss_icp import KissICP

import mavnav

log, out, voxel_m = mavnav.open_log(sys.argv[1]), sys.argv[2], float(sys.argv[3]) if len(sys.argv) > 3 else 0.1
config = KISSConfig()
config.mapping.voxel_size = voxel_m  # the map's; scans are thinned to half of it and more
config.data.max_range, config.data.min_range, config.data.deskew = 30.0, 0.0, False
odometry = KissICP(config)
with Path(out).open("w") as file:
    for scan in log.scans():
        ends = (scan.ranges_m[:, None] * scan.spec.directions)[np.isfinite(scan.ranges_m)]
        odometry.register_frame(np.column_stack((ends, np.zeros(len(ends)))), np.zeros(len(ends)))
        pose = odometry.last_pose
        half_yaw = np.arctan2(pose[1, 0], pose[0, 0]) / 2
        xy = f"{pose[0, 3]:.6f} {pose[1, 3]:.6f}"
        print(f"{scan.stamp_ns / 1e9:.9f} {xy} 0 0 0 {np.sin(half_yaw):.9f} {np.cos(half_yaw):.9f}", file=file)
