"""Run small_gicp on a log of a planar laser: small_gicp_poses.py LOG OUT.tum; pip install mavnav small-gicp."""

import sys
from pathlib import Path

import numpy as np
import small_gicp

import mavnav

log, out = mavnav.open_log(sys.argv[1]), sys.argv[2]
model, pose, last = small_gicp.GaussianVoxelMap(0.2), np.eye(4), np.eye(4)
model.set_lru(horizon=10**6, clear_cycle=10**6)  # keep the whole map
with Path(out).open("w") as file:
    for k, scan in enumerate(log.scans()):
        ends = (scan.ranges_m[:, None] * scan.spec.directions)[np.isfinite(scan.ranges_m)]
        points = np.column_stack((ends, np.zeros(len(ends))))
        cloud, _ = small_gicp.preprocess_points(points, 0.02, num_neighbors=8, num_threads=1)
        guess = pose @ np.linalg.inv(last) @ pose  # constant velocity
        if k:
            match = small_gicp.align(model, cloud, guess, max_correspondence_distance=0.5, num_threads=1)
            last, pose = pose, match.T_target_source
        x, y, yaw = pose[0, 3], pose[1, 3], np.arctan2(pose[1, 0], pose[0, 0])
        cos, sin = np.cos(yaw), np.sin(yaw)
        pose = np.array([[cos, -sin, 0, x], [sin, cos, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])  # planar
        model.insert(cloud, pose)
        print(f"{scan.stamp_ns / 1e9:.9f} {x:.6f} {y:.6f} 0 0 0 {np.sin(yaw / 2):.9f} {np.cos(yaw / 2):.9f}", file=file)
