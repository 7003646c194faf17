"""The navigator of a mission: loops that it closes in flight correct its path, its map and where it goes on."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from mavnav.pose import Pose, Trajectory
from mavnav.scan import Scan
from mavnav.simulation import mission as flying
from mavnav.simulation.mission import Flight, Navigator, Pilot, fly
from mavnav.simulation.world.scenario_file import load_scenario
from mavnav.slam.loop_closure.detection import rebuild_at
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.steps import tracked_trajectory
from mavnav.slam.methods.registry import make_method
from mavnav.slam.track import Track
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mavnav.slam.matching.steps import Step
    from mavnav.slam.methods.registry import Refiner

CORRECTION = Pose(0.0, 0.0, 3 * DEG)
"""What the loops of these tests correct the whole path by, about the start."""


def turn(track: Track, _: Refiner) -> Track:
    """Return the track with path and map turned about the start, as if loops had shown that."""
    path = tracked_trajectory(track.steps)
    poses = [CORRECTION @ path[k] for k in range(len(path))]
    rebuilt = rebuild_at(track, Trajectory.of(path.stamps_ns.tolist(), poses))
    assert rebuilt
    return rebuilt


def navigate(flight: Flight) -> tuple[Navigator, list[Step]]:
    """Return the navigator of the scans of a flight, without commands, and where it located each."""
    config, seen = flight.scenario.slam, list[Scan]()

    def coming() -> Iterator[Scan]:
        for scan in flight.scans:
            seen.append(scan)
            yield scan

    start = Track(lambda: seen, config, Motion(flight.scans[0].spec.scan_time_s), make_method(config))
    navigator = Navigator(flight.scenario, coming(), seen, start)
    return navigator, [navigator.locate() for _ in flight.scans]


def test_a_vehicle_goes_on_at_the_pose_and_in_the_map_that_its_loops_correct(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = fly(load_scenario("corner"))
    without, before = navigate(flight)
    monkeypatch.setattr(flying, "LOOP_M", 0.6 * tracked_trajectory(without.flown.steps).length_m)
    monkeypatch.setattr(flying, "close_loops", turn)
    navigator, after = navigate(flight)
    moved = [b.match.map_T_laser.gap(a.match.map_T_laser) > (0.0, 0.0) for a, b in zip(before, after, strict=True)]
    turned = moved.index(True)
    assert 0.4 * len(moved) < turned < 0.9 * len(moved)
    assert all(step.tracked for step in after)
    for a, b in zip(before[turned:], after[turned:], strict=True):
        off_m, off_rad = (CORRECTION @ a.match.map_T_laser).gap(b.match.map_T_laser)
        assert off_m < 0.02
        assert off_rad < 0.5 * DEG
    corrected = (CORRECTION @ before[5].match.map_T_laser).gap(navigator.flown.steps[5].match.map_T_laser)
    assert corrected == pytest.approx((0.0, 0.0), abs=1e-9)
    assert navigator.obstacles.grid is navigator.flown.method.grid
    assert navigator.obstacles.grid is not without.obstacles.grid


def test_loops_are_sought_once_in_a_length_of_path(monkeypatch: pytest.MonkeyPatch) -> None:
    flight, scans_then = fly(load_scenario("corner")), list[int]()

    def note(track: Track, _: Refiner) -> Track:
        scans_then.append(len(track.steps))
        return track

    monkeypatch.setattr(flying, "LOOP_M", 1.0)
    monkeypatch.setattr(flying, "close_loops", note)
    navigator, _ = navigate(flight)
    path = tracked_trajectory(navigator.flown.steps)
    lengths_m = [Trajectory(path.stamps_ns[:n], path.xyyaw[:n]).length_m for n in (1, *scans_then)]
    assert len(scans_then) >= 3
    assert all(1.0 <= b - a < 1.3 for a, b in pairwise(lengths_m))


@pytest.mark.slow
def test_a_ring_is_closed_in_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without loops in flight the vehicle believes to be 0.32 m and 10 deg from where it is at the end."""
    located: list[Pose] = []
    locate: Callable[..., Pose] = Pilot.locate

    def note(self: Pilot, step: Step, odom_T_laser: Pose | None) -> Pose:
        located.append(locate(self, step, odom_T_laser))
        return located[-1]

    monkeypatch.setattr(Pilot, "locate", note)
    flight = fly(load_scenario("ring", ("seed=4",)))
    off_m, off_rad = flight.map_T_laser[len(located) - 1].gap(located[-1])
    assert flight.mission.reached
    assert off_m < 0.1
    assert off_rad < 1 * DEG
