"""Another beginning: the first scans are partial, blocked, or of another place; and parts that are joined."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.ground_truth.references import References
from mavnav.pipelines.maps import references_in_map
from mavnav.pose import Pose, Trajectory
from mavnav.scan import LaserSpec, Scan
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.relocalization import AGREEING_SCANS
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Step
from mavnav.slam.pipeline import run_slam
from mavnav.slam.recovery.parts import SEARCHED_SCANS, consensus, part_pose, spread_out
from mavnav.slam.result import SlamResult
from support.marks import slow
from support.synthetic import DEG, TOUR, along, box, furnished_rooms, record, room

SMALL = LaserSpec(-120 * DEG, 1.0 * DEG, 241, 0.02, 5.6, 0.0, 0.1)


@cache
def tour() -> tuple[Scan, ...]:
    return tuple(record(furnished_rooms(), along(TOUR[:3]), SMALL).scans)


def partial(scan: Scan, rng: np.random.Generator) -> Scan:
    kept = np.arange(scan.spec.beams) < scan.spec.beams // 4
    return replace(scan, ranges_m=np.where(kept, scan.ranges_m, np.nan))


def blocked(scan: Scan, rng: np.random.Generator) -> Scan:
    return replace(scan, ranges_m=rng.uniform(0.25, 0.27, scan.spec.beams))


def blank(scan: Scan, rng: np.random.Generator) -> Scan:
    return replace(scan, ranges_m=np.full(scan.spec.beams, np.nan))


def tracked(scans: list[Scan]) -> SlamResult:
    return run_slam(lambda: scans, Config(), 0.1)


@cache
def length_without(first: int) -> float:
    """Return how long the path of the tour without its first scans is, m."""
    return tracked(list(tour()[first:])).trajectory.length_m


@pytest.mark.parametrize(
    ("spoil", "first"),
    [(blank, 10), slow(partial, 10), slow(partial, 1), slow(blocked, 1), slow(blocked, 10), slow(blank, 1)],
)
def test_spoilt_scans_at_the_beginning_cost_no_more_than_themselves(spoil, first: int) -> None:
    rng = np.random.default_rng(1)
    scans = [spoil(scan, rng) if k < first else scan for k, scan in enumerate(tour())]
    found = tracked(scans)
    shortest_m, longest_m = (length_without(n) for n in (first, 0))
    assert found.steps.column("tracked")[first:].all()
    assert not found.lost_for_good
    later = found.trajectory.stamps_ns >= scans[first].stamp_ns
    later_m = Trajectory(found.trajectory.stamps_ns[later], found.trajectory.xyyaw[later]).length_m
    assert later_m == pytest.approx(shortest_m, abs=0.05)
    unobserved = any("motion in one direction is not observable" in text for text in found.warnings)
    assert found.trajectory.length_m < longest_m + 0.05 or unobserved  # a partial scan may see a single wall
    assert bool(found.parts) == (spoil is not blank)
    assert sum("left out" in text for text in found.warnings) == sum(not part.joined for part in found.parts)


def test_scans_of_another_room_at_the_beginning_are_left_out_and_reported() -> None:
    other = record(np.vstack((room(3.0, 2.0), box(1.0, 1.4, 0.4, 0.3))), along([(0.6, 0.6), (2.4, 0.6)]), SMALL).scans
    scans = [replace(s, stamp_ns=k * 100_000_000) for k, s in enumerate([*other[:12], *tour()])]
    found = tracked(scans)
    assert found.steps.column("tracked").tolist() == [False] * 12 + [True] * len(tour())
    assert [(part.scans, part.joined) for part in found.parts] == [(12, False), (len(tour()), True)]
    assert "12 scans from 0.0 to 1.1 s" in found.warnings[0]
    assert found.begin_ns == scans[12].stamp_ns


@pytest.mark.parametrize("first_is_largest", [slow(True), False])
def test_the_parts_before_and_after_a_lost_middle_are_joined(first_is_largest: bool) -> None:
    way = TOUR[:3] if first_is_largest else [(4.65, 5.0), (4.65, 3.4), (4.6, 2.9), (2.4, 2.9), (1.0, 2.9)]
    longer = record(furnished_rooms(), along(way), SMALL)
    shorter = record(furnished_rooms(), along([(0.9, 0.9), (2.4, 0.8)]), SMALL, seed=1)
    first, second = (longer, shorter) if first_is_largest else (shorter, longer)
    middle = [blank(first.scans[-1], np.random.default_rng(0))] * 30
    scans = [replace(s, stamp_ns=k * 100_000_000) for k, s in enumerate([*first.scans, *middle, *second.scans])]
    found = tracked(scans)
    parts = [(part.scans, part.joined) for part in found.parts]
    assert parts == ([] if first_is_largest else [(len(d.scans), True) for d in (first, second)])  # or found at once
    assert len(found.trajectory) == len(scans) - len(middle)
    assert not found.lost_for_good
    truth = Trajectory(found.trajectory.stamps_ns, np.vstack((first.world_T_laser.xyyaw, second.world_T_laser.xyyaw)))
    log = SimpleNamespace(truth=SimpleNamespace(world_T_laser=truth))
    in_map, _ = references_in_map(References(), log, found.begin_ns)
    assert np.abs(in_map.truth.xyyaw - found.trajectory.xyyaw).max() < 0.05


@pytest.mark.slow
def test_the_larger_of_two_rooms_is_the_map_and_the_log_is_lost() -> None:
    other = record(np.vstack((room(3.0, 2.0), box(1.0, 1.4, 0.4, 0.3))), along([(0.6, 0.6), (2.4, 0.6)]), SMALL).scans
    scans = [replace(s, stamp_ns=k * 100_000_000) for k, s in enumerate([*tour()[:40], *other])]
    found = tracked(scans)
    assert found.lost_for_good
    assert [(part.scans, part.joined) for part in found.parts] == [(40, True), (len(other), False)]


def step(pose: Pose) -> Step:
    return Step(0, 0, no_match(pose), tracked=True)


def test_scans_of_a_laser_at_rest_count_once() -> None:
    assert len(spread_out([step(Pose(0.01 * k)) for k in range(20)])) == 1
    assert len(spread_out([step(Pose(0.3 * k)) for k in range(4)])) == 4


def test_the_search_for_a_part_ends_when_too_few_of_its_scans_can_be_found() -> None:
    searched: list[object] = []
    track = SimpleNamespace(refiner=SimpleNamespace(relocalize=lambda *args: searched.append(args)), motion=Motion(0.1))
    part = [step(Pose(0.3 * k))._replace(index=k) for k in range(SEARCHED_SCANS)]
    assert part_pose(part, dict.fromkeys(range(SEARCHED_SCANS)), track) is None
    assert len(searched) == SEARCHED_SCANS - AGREEING_SCANS + 1


def test_scans_of_a_part_must_agree() -> None:
    places, moved = [Pose(0.3 * k) for k in range(5)], Pose(1.0, 2.0, 0.5)
    pairs = [(place, moved @ place) for place in places]
    assert consensus(pairs[: AGREEING_SCANS - 1]) is None
    assert consensus(pairs[:AGREEING_SCANS]).gap(moved)[0] < 1e-9
    wrong = [(place, Pose(5.0 + k, 1.0, 2.0 * k)) for k, place in enumerate(places[:AGREEING_SCANS])]
    assert consensus([*pairs[:AGREEING_SCANS], *wrong]) is None
