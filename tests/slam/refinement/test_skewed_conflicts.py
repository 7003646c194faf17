"""A sweep taken in a turn conflicts with the map as recorded; that is no sign of a laser that tilts."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.scan import LaserSpec, Scan
from mavnav.slam.findings import NOT_PLANAR
from mavnav.slam.pipeline import run_slam
from mavnav.slam.refinement import refine
from mavnav.units import DEG
from support.synthetic import box, cast, furnished_rooms

BEAMS, PERIOD_S, TURN_RAD_S = 360, 0.2, 100 * DEG
SPEC = LaserSpec(-np.pi, 2 * np.pi / BEAMS, BEAMS, 0.05, 12.0, time_increment_s=PERIOD_S / BEAMS)
WALLS = np.vstack([furnished_rooms(), *(box(2.2 + dx, 1.4 + dy, 0.06, 0.06) for dx in (0.0, 0.5) for dy in (0.0, 0.5))])


def spin(scans: int = 40) -> list[Scan]:
    """Return the sweeps of a robot vacuum that turns while it creeps ahead, every beam cast at its own heading."""
    rng, found = np.random.default_rng(0), []
    for k in range(scans):
        time_s = (k + np.arange(BEAMS) / BEAMS) * PERIOD_S
        yaw_rad = TURN_RAD_S * np.maximum(time_s - 1.0, 0.0)
        ranges_m = cast(WALLS, (1.6, 0.9 + 0.024 * k), SPEC.angles_rad + yaw_rad) + rng.normal(0.0, 0.008, BEAMS)
        found.append(Scan(int(k * PERIOD_S * 1e9), np.where(ranges_m < SPEC.range_max_m, ranges_m, np.nan), SPEC))
    return found


def test_turning_is_planar(monkeypatch: pytest.MonkeyPatch) -> None:
    scans = spin()
    found = run_slam(lambda: scans, Config(), PERIOD_S)
    monkeypatch.setattr(refine, "SKEWED_RAD", np.inf)
    as_recorded = run_slam(lambda: scans, Config(), PERIOD_S)
    assert found.doubt is not None
    assert as_recorded.doubt is not None
    np.testing.assert_array_equal(found.trajectory.xyyaw, as_recorded.trajectory.xyyaw)
    assert NOT_PLANAR in {reason.name for reason in as_recorded.doubt.reasons}
    assert NOT_PLANAR not in {reason.name for reason in found.doubt.reasons}
    assert found.doubt.probability < as_recorded.doubt.probability
