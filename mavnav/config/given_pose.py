"""Bounds of the poses that a user gives, on the command line, in a manifest or in Python."""

from __future__ import annotations

from math import isfinite, pi

from mavnav.units import LARGEST_COORDINATE_M


def pose_problem(x_m: float, y_m: float, yaw_rad: float) -> str:
    """Return what is wrong with a pose and what to do, to follow its name; empty if nothing is."""
    if not all(map(isfinite, (x_m, y_m, yaw_rad))):
        return "has a number that is not finite; give x, y and yaw in m, m, rad"
    if max(abs(x_m), abs(y_m)) > LARGEST_COORDINATE_M:
        return f"is farther than {LARGEST_COORDINATE_M:g} m from the origin; give x and y in m"
    if abs(yaw_rad) > 2 * pi:
        return "has a yaw of more than a turn; give it in rad, for 90 deg 1.5708"
    return ""
