"""The wide search: the place is found, flips are told apart, twins are ambiguous, and the track comes back."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.config.loading import load_config
from mavnav.config.models import Config
from mavnav.kernels.maps.conflicts import conflicts
from mavnav.mapping.tiled_arrays import blank_strips
from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.slam.matching import relocalization
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.prior_map import prior_map_of
from mavnav.slam.matching.relocalization import (
    CANDIDATES,
    CONFLICT_POINTS,
    STEP_M,
    WORTH_PRUNING,
    apart,
    around,
    candidates,
    everywhere,
    least_growth,
    lowest,
    lowest_exhaustive,
    lowest_starts,
    minima,
    motion_cost,
    reaches,
    unambiguous,
    with_conflicts,
    within_reach,
)
from mavnav.slam.matching.scan_matching import Match, MatchVerdict, first_match, no_match
from mavnav.slam.methods import robust
from mavnav.slam.methods.localization import Localizer
from mavnav.slam.methods.robust import Robust
from mavnav.slam.pipeline import run_slam
from support.marks import slow
from support.memory_use import added_mb
from support.synthetic import TOUR, along, box, furnished_rooms, polyline, record, room, scan_at

PERIOD_NS = 100_000_000


def mapped(segments: np.ndarray, poses: list[Pose]) -> Robust:
    """Return the method with a map of the scans from known poses."""
    method, rng = Robust(Config()), np.random.default_rng(0)
    for pose in poses:
        for _ in range(4):
            scan = scan_at(segments, pose, noise=0.01, rng=rng)
            method.insert(scan, pose, Motion(0.1))
    return method


def look_everywhere(method: Robust, scan: Scan) -> Match | None:
    return method.relocalize(scan, no_match(Pose()), Motion(0.1).started_at(Pose(1.0, 1.0), -5_000_000_000))


def test_a_laser_is_found_anywhere_in_its_map() -> None:
    method = mapped(furnished_rooms(), [Pose(1.0, 1.0, 0.5), Pose(4.6, 0.8, 2.0), Pose(3.0, 3.0, -1.0)])
    there = Pose(3.9, 1.1, -2.6)
    found = look_everywhere(method, scan_at(furnished_rooms(), there, noise=0.01))
    assert found is not None
    assert there.between(found.map_T_laser).distance_m < 0.03
    assert abs(there.between(found.map_T_laser).yaw_rad) < 0.02
    assert found.conflicts < 0.05


@pytest.mark.parametrize("off_m", [0.03, 0.2])
def test_only_the_chosen_match_counts_its_conflicts(off_m: float, monkeypatch: pytest.MonkeyPatch) -> None:
    method = mapped(furnished_rooms(), [Pose(1.0, 1.0, 0.5)])
    person = np.vstack((furnished_rooms(), box(1.6, 1.2, 0.15, 0.15)))
    scan, expected = scan_at(person, Pose(1.0, 1.0, 0.5), stamp_ns=PERIOD_NS), Pose(1.0 - off_m, 1.0, 0.5)
    counted = list[Match]()
    monkeypatch.setattr(robust, "with_conflicts", lambda *given: counted.append(with_conflicts(*given)) or counted[-1])
    match = method.match(scan, expected, Motion(0.1).started_at(expected, 0))
    assert abs(expected.between(match.map_T_laser).distance_m - off_m) < 0.01
    assert match.conflicts == counted[0].conflicts > 0.0
    assert len(counted) == 1


@pytest.mark.parametrize("beginning", [Pose(0.0, 0.0, 0.3), Pose(7.0, -9.0, 0.3), Pose(-30.0, 4.0, 0.3)])
def test_everywhere_is_where_the_map_was_seen_free(beginning: Pose) -> None:
    method = Robust(Config())
    method.insert(scan_at(furnished_rooms(), Pose(1.0, 1.0, 0.5)), beginning, Motion(0.1))
    known = method.known
    rows, cols = np.nonzero(known.passes)
    free = known.passes[rows, cols] > known.hits[cols // 64, rows, cols % 64]
    centres_m = (np.column_stack((cols, rows))[free] + 0.5) * known.cell_m + np.array(known.origin_xy_m)
    expected = set(map(tuple, np.round(centres_m / STEP_M).astype(int)[:, ::-1].tolist()))
    xy_m, yaws_rad = everywhere(known)
    found = np.round(xy_m / STEP_M).astype(int)[:, ::-1].tolist()
    assert list(map(tuple, found)) == sorted(expected)
    assert len(yaws_rad) == 90
    assert everywhere(Robust(Config()).known)[0].shape == (0, 2)


def test_everywhere_takes_little_memory_beside_the_map() -> None:
    known = Robust(Config()).known
    known.passes, known.hits = np.zeros((4096, 4096), np.uint16), blank_strips((4096, 4096), np.uint16)
    known.passes[...] = 1
    assert len(everywhere(known)[0]) == 820**2
    assert added_mb(lambda: everywhere(known)) < 100.0  # masks and cells of the whole map took 1.1 GB


def test_a_large_region_is_searched_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    method = mapped(furnished_rooms(), [Pose(1.0, 1.0, 0.5), Pose(4.6, 0.8, 2.0), Pose(3.0, 3.0, -1.0)])
    points = method.match_points(scan_at(furnished_rooms(), Pose(3.9, 1.1, -2.6), noise=0.01))
    region, exhaustive = everywhere(method.known), Config(search="exhaustive")
    found = []
    for parts in (1, 7):
        monkeypatch.setattr(relocalization, "AT_ONCE", -(-len(region[0]) // parts))
        found.append(candidates(points, method.lines, method.known, region, exhaustive))
    assert len(found[0]) == len(found[1]) == CANDIDATES
    best = [unambiguous(some, 0.0, method.config) for some in found]
    assert best[0] == best[1] is not None


@pytest.mark.parametrize(
    ("seed", "cell_mm"),
    [
        *[(0, 20.0), (1, 50.0), (2, 20.0), (3, 50.0)],
        *(slow(*case) for case in [(0, 50.0), (1, 20.0), (2, 50.0), (3, 20.0)]),
    ],
)
def test_the_pruned_search_finds_the_minima_of_the_exhaustive_one(seed: int, cell_mm: float) -> None:
    rng = np.random.default_rng(seed)
    method = Robust(load_config(overrides={"robust.cell_mm": cell_mm}))
    for pose in (Pose(1.0, 1.0, 0.5), Pose(4.6, 0.8, 2.0), Pose(3.0, 3.0, -1.0)):
        method.insert(scan_at(furnished_rooms(), pose, noise=0.01, rng=rng), pose, Motion(0.1))
        there = Pose(*rng.uniform((0.6, 0.6, -3), (4.6, 3.0, 3)).tolist())
        few = method.match_points(scan_at(furnished_rooms(), there, noise=0.02, rng=rng))[:40]
        for region in (everywhere(method.known), around(there, 2.5, np.pi), around(Pose(-4.0, 9.0, 1.0), 3.0, 0.7)):
            assert region[0].size * len(region[1]) * len(few) > 2 * WORTH_PRUNING
            args = few, method.lines, region, 0.15, 30
            assert lowest(*args) == lowest(*args, exhaustive=True)


def test_cells_that_do_not_divide_the_step_are_searched_exhaustively() -> None:
    method = Robust(load_config(overrides={"robust.cell_mm": 30.0}))
    method.insert(scan_at(furnished_rooms(), Pose(1.0, 1.0, 0.5)), Pose(1.0, 1.0, 0.5), Motion(0.1))
    few = method.match_points(scan_at(furnished_rooms(), Pose(1.2, 1.0, 0.4)))[:100]
    args = few, method.lines, around(Pose(1.0, 1.0, 0.5), 2.5, np.pi), 0.15, 6
    assert lowest(*args) == lowest(*args, exhaustive=True)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_cost_is_reached_from_the_least_one_of_the_region_on(seed: int) -> None:
    rng = np.random.default_rng(seed)
    method, config = mapped(furnished_rooms(), [Pose(1.0, 1.0, 0.5), Pose(4.6, 0.8, 2.0)]), load_config()
    there = Pose(*rng.uniform((0.6, 0.6, -3), (4.6, 3.0, 3)).tolist())
    points, region = method.match_points(scan_at(furnished_rooms(), there, noise=0.01)), around(there, 1.0, 0.5)
    few, truncate_m = points[: config.robust.expert.first_level_points], config.robust.expert.truncate_m
    least = lowest_exhaustive(few, method.lines, region, truncate_m, 1)[0][0] / truncate_m**2
    limits = (0.9 * least, 0.999 * least, 1.001 * least, 1.1 * least)
    reached = [reaches(points, method.lines, region, config, limit) for limit in limits]
    assert reached == [False, False, True, True]


def test_a_sample_tells_what_speaks_against_a_place() -> None:
    there = Pose(3.9, 1.1, -2.6)
    method = mapped(furnished_rooms(), [Pose(1.0, 1.0, 0.5), Pose(4.6, 0.8, 2.0), there])
    points = method.match_points(scan_at(furnished_rooms(), there, noise=0.01))
    assert len(points) > CONFLICT_POINTS
    known, lines = method.known, method.lines
    for pose, against in ((there, (0.0, 0.05)), (Pose(3.9, 1.1, 0.5), (0.2, 1.0))):
        counts = known.lattice, known.hits, known.passes, lines.nearest, lines.geometry
        share = conflicts(points, pose.as_array(), *counts) / len(points)
        assert against[0] <= share <= against[1]
        assert with_conflicts(no_match(pose), points, lines, known).conflicts == pytest.approx(share, abs=0.08)


def test_a_room_that_looks_the_same_when_turned_is_ambiguous() -> None:
    method = mapped(room(4.0, 2.5), [Pose(1.0, 1.0, 0.0), Pose(3.0, 1.5, np.pi)])
    assert look_everywhere(method, scan_at(room(4.0, 2.5), Pose(1.5, 1.2, 0.3), noise=0.01)) is None


def test_another_room_is_not_found_in_the_map() -> None:
    method = mapped(furnished_rooms(), [Pose(1.0, 1.0, 0.5), Pose(4.6, 0.8, 2.0)])
    assert look_everywhere(method, scan_at(room(2.0, 9.0), Pose(1.0, 3.0, 0.3), noise=0.01)) is None


def test_a_scan_of_few_points_is_not_looked_for() -> None:
    method = mapped(room(), [Pose(1.0, 1.0)])
    scan = scan_at(room(), Pose(1.0, 1.0))
    assert look_everywhere(method, Scan(0, np.full(scan.spec.beams, np.nan), scan.spec)) is None


def test_minima_lie_apart_and_begin_with_the_lowest() -> None:
    xy, yaws = within_reach(Pose(1.0, 2.0, 3.0), 0.5)
    costs = np.hypot(*(xy - (1.3, 2.2)).T)[None, :] + np.abs(yaws - 2.9)[:, None]
    expected = np.sort(costs, axis=None)[0]
    starts = minima(costs, xy, yaws)
    found = [pose for _, pose in starts]
    assert starts[0][0] == expected
    assert Pose(1.3, 2.2, 2.9).between(found[0]).distance_m < 0.06
    assert all(apart(a, b) for k, a in enumerate(found) for b in found[:k])


def test_of_minima_of_several_parts_the_lowest_that_lie_apart_count() -> None:
    starts = [(0.3, Pose(0.0, 0.0)), (0.2, Pose(0.2, 0.0)), (0.1, Pose(3.0, 0.0)), (0.4, Pose(0.2, 0.0, 0.5))]
    assert [cost for cost, _ in lowest_starts(starts, 3)] == [0.1, 0.2, 0.4]
    assert [cost for cost, _ in lowest_starts(starts, 2)] == [0.1, 0.2]


@pytest.mark.parametrize("elapsed_s", [0.1, 0.7, 30.0])
def test_reach_grows_with_time_and_ends(elapsed_s: float) -> None:
    xy, yaws = within_reach(Pose(1.0, 2.0, 0.5), elapsed_s)
    radius_m = np.hypot(*(xy - (1.0, 2.0)).T).max()
    assert radius_m <= min(max(0.15 + 1.5 * elapsed_s, 0.3), 2.5) + 1e-9
    assert [1.0, 2.0] in xy.tolist()
    assert np.isclose(yaws, 0.5).any()


def test_surprise_is_measured_in_accelerations() -> None:
    assert motion_cost(Pose(), Pose(), 0.1) == 0.0
    assert motion_cost(Pose(), Pose(0.6, 0.0, 0.0), 0.1) > 10
    assert motion_cost(Pose(), Pose(0.6, 0.0, 0.0), 0.5) == pytest.approx(1.0)


@pytest.mark.parametrize(("walls", "observable"), [(room(4.0, 3.0), True), (polyline((-20, 0), (20, 0)), False)])
def test_a_pose_is_observable_with_walls_on_all_sides(walls: np.ndarray, observable: bool) -> None:
    here = Pose(1.5, 1.2, 0.3)
    method = mapped(walls, [here])
    points = method.match_points(scan_at(walls, here))
    least = least_growth(points, here, method.lines, Config())
    assert least > 0.2 if observable else least < 0.03


# ---- the whole loop --------------------------------------------------------------------------------------------------


def with_blanks(scans: list[Scan], blanks: range) -> list[Scan]:
    return [Scan(s.stamp_ns, np.full(s.spec.beams, np.nan), s.spec) if k in blanks else s for k, s in enumerate(scans)]


def test_a_laser_carried_through_its_map_is_found_again_and_the_gap_is_told() -> None:
    recording = record(furnished_rooms(), along(TOUR[:4], speed_m_s=0.8))
    truth, n = recording.map_T_laser, len(recording.scans)
    scans = [*with_blanks(recording.scans, range(n - 2, n)), *recording.scans[20:40]]
    scans = [Scan(k * PERIOD_NS, s.ranges_m, s.spec) for k, s in enumerate(scans)]
    outcome = run_slam(lambda: scans, Config(), 0.1)
    assert [lost.recovered for lost in outcome.lost] == [True]
    assert outcome.lost[0].scans < 18
    assert truth[39].between(outcome.trajectory[-1]).distance_m < 0.05


def test_scans_that_wait_are_believed_once_the_track_goes_on() -> None:
    recording = record(furnished_rooms(), along(TOUR[:3]))
    gap = range(30, 37)
    blind = with_blanks(recording.scans, gap)
    on_line = run_slam(lambda: blind, Config(final_pass=False), 0.1)
    settled = run_slam(lambda: blind, Config(), 0.1)
    assert {s.index for s in settled.steps if not s.tracked} == set(gap)
    assert set(gap) <= {s.index for s in on_line.steps if not s.tracked}


def test_far_from_where_it_was_expected_a_match_must_convince() -> None:
    method, here = Robust(Config()), Motion(0.1).started_at(Pose(), 0)
    scan = scan_at(furnished_rooms(), Pose(3.0, 2.2, 1.0), stamp_ns=200_000_000)
    match = first_match(300)._replace(map_T_laser=Pose(0.3, 0.0, 0.3), inliers=0.76)
    assert method.gate(match._replace(motion_cost=0.5), scan, here) is MatchVerdict.SURE
    assert method.gate(match._replace(motion_cost=3.4), scan, here) is MatchVerdict.REFUSED
    assert method.gate(match._replace(motion_cost=3.4, inliers=0.9), scan, here) is MatchVerdict.PROBABLE


def two_rooms(seed: int) -> np.ndarray:
    """Return two furnished rooms of different sizes, 30 m apart."""
    rng = np.random.default_rng(seed)
    walls = []
    for x_m in (0.0, 30.0):
        walls.append(box(x_m, 0, rng.uniform(4, 7), rng.uniform(3, 5)))
        for _ in range(3):
            at = x_m + rng.uniform(-1.5, 1.5), rng.choice([-1, 1]) * rng.uniform(1.0, 1.6)
            walls.append(box(*at, rng.uniform(0.3, 1), rng.uniform(0.3, 0.7)))
    return np.vstack(walls)


@pytest.mark.slow
def test_a_laser_carried_into_another_room_is_not_found_in_the_first() -> None:
    walls = two_rooms(seed := 3)
    first = record(walls, along([(-1, 0.2), (1.2, -0.2), (-0.5, 0.1)]), seed=seed).scans
    way = along([(29, 0.2), (31.2, -0.2), (29.5, 0.1)], start_ns=first[-1].stamp_ns + PERIOD_NS)
    other = record(walls, way, seed=seed + 100).scans
    outcome = run_slam(lambda: [*first, *other[:80]], Config(), 0.1)
    assert outcome.lost_for_good
    assert outcome.trajectory.stamps_ns[-1] == first[-1].stamp_ns


def test_after_a_long_gap_little_may_speak_against_a_place() -> None:
    method, here = Robust(Config()), Motion(0.1).started_at(Pose(), 0)
    soon, later, late = (scan_at(room(), Pose(3.0, 2.0), stamp_ns=k * PERIOD_NS) for k in (11, 24, 26))
    match = first_match(300)._replace(inliers=0.85, conflicts=0.13)
    assert method.gate(match, soon, here) is MatchVerdict.SURE
    assert method.gate(match, later, here) is MatchVerdict.PROBABLE
    assert method.gate(match, late, here) is MatchVerdict.REFUSED
    assert method.gate(match._replace(conflicts=0.03), late, here) is MatchVerdict.PROBABLE
    led = here._replace(odometry=lambda _: Pose())
    assert method.gate(match, late, led) is MatchVerdict.REFUSED  # odometry does not notice that a vehicle is carried
    known = prior_map_of(method.grid.by_rows(), Pose())
    assert Localizer(Config(), known).gate(match, late, here) is MatchVerdict.PROBABLE
