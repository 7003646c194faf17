"""A log of sparse scans is tracked twice, and the crisper map is kept."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.slam.doubt.features import resampled_poses
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import Match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.retries import attempt
from mavnav.slam.retries.attempt import COARSER, FEW_POINTS, SPARSE_SCANS, has_sparse_scans, rank
from mavnav.slam.track import Track
from support.synthetic import TOUR, Recording, along, furnished_rooms, record

PERIOD_S = 0.1


def thinned(scan: Scan) -> Scan:
    """Look through seven slits: some fifty points are left to match."""
    return replace(scan, ranges_m=np.where(np.arange(scan.spec.beams) % 100 < 16, scan.ranges_m, np.nan))


@pytest.fixture(scope="module")
def tour() -> Recording:
    return record(furnished_rooms(), along(TOUR[:2]), noise=0.01)


@pytest.fixture(scope="module")
def sparse(tour: Recording) -> list[Scan]:
    return [thinned(scan) for scan in tour.scans]


def replay(scans: list[Scan], config: Config | None = None) -> SlamResult:
    return run_slam(lambda: scans, config or Config(loop_closure="off"), PERIOD_S)


@given(points=st.lists(st.integers(30, 200), max_size=30), untracked=st.sets(st.integers(0, 29)))
def test_a_track_is_in_doubt_where_believed_scans_have_few_points(points: list[int], untracked: set[int]) -> None:
    match = Match(Pose(), 0.0, 0, 1.0, 1, 1, converged=True)
    steps = Steps(Step(k, k, match._replace(beams_used=n), k not in untracked) for k, n in enumerate(points))
    few = [n for k, n in enumerate(points) if n < FEW_POINTS and k not in untracked]
    assert has_sparse_scans(steps) == (len(few) >= SPARSE_SCANS)


def test_the_crisper_of_two_tracks_is_kept(sparse: list[Scan], monkeypatch: pytest.MonkeyPatch) -> None:
    both = replay(sparse)
    monkeypatch.setattr(attempt, "has_sparse_scans", lambda steps: False)
    quick = Config(loop_closure="off")
    alone = [replay(sparse, config) for config in (quick, quick.with_voxels(COARSER))]
    blurs = [int(np.count_nonzero(one.grid.hits)) for one in alone]
    kept = alone[int(np.argmin(blurs))]
    assert (both.tracks_compared, alone[0].tracks_compared) == (2, 1)
    assert blurs[0] != blurs[1]
    np.testing.assert_array_equal(both.trajectory.xyyaw, kept.trajectory.xyyaw)


def tracked(scans: list[Scan]) -> Track:
    config = Config()
    return Track(lambda: scans, config, Motion(PERIOD_S), make_method(config)).over(scans)


def test_scans_lost_weigh_more_than_cells(tour: Recording) -> None:
    whole = tracked(tour.scans)
    blind = replace(tour.scans[0], ranges_m=np.full(tour.scans[0].spec.beams, np.nan))
    gap = tracked([replace(blind, stamp_ns=s.stamp_ns) if 40 <= k < 60 else s for k, s in enumerate(tour.scans)])
    assert np.count_nonzero(gap.method.grid.hits) < np.count_nonzero(whole.method.grid.hits)
    assert rank(whole) < rank(gap)


def test_plenty_of_points_on_line_and_the_paper_want_no_second_opinion(tour: Recording, sparse: list[Scan]) -> None:
    assert replay(tour.scans[:30]).tracks_compared == 1
    assert replay(sparse[:30], Config(final_pass=False)).tracks_compared == 1
    assert replay(sparse[:30], Config(method="paper")).tracks_compared == 1


def test_the_second_track_is_told_as_such(sparse: list[Scan]) -> None:
    passes: dict[str, int] = {}
    run_slam(lambda: sparse[:20], Config(), PERIOD_S, None, passes.__setitem__)
    assert passes == {"track": 20, "track again": 20, "close loops": 0, "final pass": 20, "draw map": 20}


def test_a_stopped_run_keeps_the_first_track(sparse: list[Scan]) -> None:
    calls = 0

    def scans() -> Iterator[Scan]:
        nonlocal calls
        calls += 1
        return iter(sparse[:40] if calls == 1 else sparse[:10])

    outcome = run_slam(scans, Config(), PERIOD_S)
    assert (outcome.tracks_compared, len(outcome.steps)) == (1, 40)


def test_a_refused_coarser_track_is_not_tracked_once_more_for_the_doubt(sparse: list[Scan]) -> None:
    track = tracked(sparse[:30])
    never = replace(attempt.COARSER_VOXELS, better=lambda _, __: False)
    refused = replace(attempt.try_again(track, [never]), log_scans=lambda: pytest.fail("the scans were read again"))
    np.testing.assert_array_equal(resampled_poses(refused), resampled_poses(track))


def test_a_track_of_other_scans_is_tracked_once_more_for_the_doubt(sparse: list[Scan]) -> None:
    track = attempt.try_again(tracked(sparse[:30]), [replace(attempt.COARSER_VOXELS, better=lambda _, __: False)])
    lost = Steps(step._replace(tracked=step.index != 20) for step in track.steps)
    poses = resampled_poses(replace(track, steps=lost))
    assert poses is not None
    assert len(poses) == 29
