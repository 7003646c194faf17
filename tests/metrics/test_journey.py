"""Scans of a run as input of the metrics: scans of several geometries are compared with each other."""

from __future__ import annotations

from math import tau

import numpy as np
import pytest

from mavnav.metrics.journey import Journey, placed_scans
from mavnav.pose import Trajectory
from mavnav.scan import LaserSpec, Scan

USUAL = LaserSpec(-0.75 * np.pi, 1.5 * np.pi / 360, 361, 0.02, 5.6)


def journey(*specs: LaserSpec) -> Journey:
    ranges = np.random.default_rng(3).uniform(0.5, 5.0, 400)
    scans = [Scan(k + 1, ranges[: spec.beams].copy(), spec) for k, spec in enumerate(specs)]
    stamps_ns = np.arange(1, len(specs) + 1, dtype=np.int64)
    return Journey(Trajectory(stamps_ns, np.zeros((len(specs), 3))), lambda: scans, 1.0)


@pytest.mark.parametrize(
    "other",
    [
        LaserSpec(-0.75 * np.pi, 1.5 * np.pi / 359, 360, 0.02, 5.6),
        LaserSpec(0.75 * np.pi, -1.5 * np.pi / 360, 361, 0.02, 5.6),
        LaserSpec(-0.5 * np.pi, np.pi / 180, 181, 0.02, 5.6),
        LaserSpec(0.1, tau / 300, 300, 0.02, 5.6),
        LaserSpec(3.0, -tau / 90, 90, 0.02, 5.6),
    ],
)
def test_another_geometry_is_brought_to_that_of_most_scans_by_the_nearest_beam(other: LaserSpec) -> None:
    placed = placed_scans(journey(other, USUAL, USUAL), np.arange(3))
    assert placed is not None
    assert placed.spec == USUAL
    assert list(placed.others) == [0]
    recorded_m, directions = placed.recorded_beams(0)
    assert len(recorded_m) == len(directions) == other.beams
    for k, angle_rad in enumerate(USUAL.angles_rad):
        off_rad = np.abs((other.angles_rad - angle_rad + np.pi) % tau - np.pi)
        outside_rad = off_rad.min() - 0.5 * abs(other.angle_step_rad)
        if outside_rad < -1e-9:
            assert placed.ranges_m[0, k] == recorded_m[off_rad.argmin()]
        elif outside_rad > 1e-9:
            assert np.isnan(placed.ranges_m[0, k])


def test_one_geometry_is_left_as_it_is() -> None:
    placed = placed_scans(journey(USUAL, USUAL), np.arange(2))
    assert placed is not None
    assert not placed.others
    assert np.array_equal(placed.recorded_beams(1)[0], placed.ranges_m[1])
    assert placed.recorded_beams(1)[1] is USUAL.directions
