"""Attempts to track a log again: which track is kept, and what is reported."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.scan import Scan
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.methods.registry import make_method
from mavnav.slam.retries.attempt import Attempt, try_again
from mavnav.slam.track import Track
from support.synthetic import TOUR, along, furnished_rooms, record

SCANS = record(furnished_rooms(), along(TOUR, period_s=0.3)).scans[:6]


def tracked() -> Track:
    track = Track(lambda: SCANS, Config(), Motion(0.3), make_method(Config()))
    return track.over(SCANS)


def later(track: Track) -> Track:
    return replace(track, begin=track.begin + 1)


@pytest.mark.parametrize(("better", "kept"), [(True, True), (False, False), (None, True)])
def test_the_better_track_is_kept_and_every_attempt_reported(*, better: bool | None, kept: bool) -> None:
    first = tracked()
    rule = None if better is None else lambda other, track: better and other.begin > track.begin
    found = try_again(first, [Attempt("one", later, rule), Attempt("two", later, rule)])
    assert found.begin == found.steps.column("tracked").tolist().index(True) == 2 * kept
    assert found.findings.attempts == (("one", kept), ("two", kept))


def test_an_attempt_that_does_not_apply_is_not_made() -> None:
    first = tracked()
    assert try_again(first, [Attempt("none", lambda _: None)]) is first


def test_an_attempt_is_looked_at_again_only_where_the_track_has_changed() -> None:
    asked: list[int] = []

    def never(track: Track) -> None:
        asked.append(track.begin)

    none, one = Attempt("none", never), Attempt("one", later)
    try_again(tracked(), [none, none, one, none])
    assert asked == [0, 1]


def test_an_attempt_does_not_count_if_the_run_is_stopped() -> None:
    def stopped() -> Iterator[Scan]:
        return iter(SCANS[:3])

    first = tracked()
    assert try_again(first, [Attempt("fewer", lambda track: replace(track, log_scans=stopped))]) is first
