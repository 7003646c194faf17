"""The search close to the prediction: a good match near the edge of its window is searched again around itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.methods.robust import Robust
from support.synthetic import furnished_rooms, scan_at

if TYPE_CHECKING:
    from mavnav.slam.matching.scan_matching import Match

MS = 1_000_000
START = Pose(3.0, 2.2, 1.0)


def match_after(
    step: Pose, motion: Motion, monkeypatch: pytest.MonkeyPatch, config: Config | None = None
) -> tuple[Pose, int]:
    """Return the pose at which a scan is matched after a step, and how often the second window is searched."""
    method, search, searches = Robust(config or Config()), Robust._search_around, list[Any]()

    def count(*args: Any) -> list[Match]:
        searches.append(args)
        return search(*args)

    monkeypatch.setattr(Robust, "_search_around", count)
    method.insert(scan_at(furnished_rooms(), START), Pose(), motion)
    match = method.match(scan_at(furnished_rooms(), START @ step, stamp_ns=100 * MS), Pose(), motion)
    return match.map_T_laser, len(searches)


@pytest.mark.parametrize("step", [Pose(0.01), Pose(0.04, 0.01, 0.06), Pose(0.3)])
def test_without_odometry_a_good_match_off_the_prediction_is_searched_again_there(
    step: Pose, monkeypatch: pytest.MonkeyPatch
) -> None:
    pose, searches = match_after(step, Motion(0.1), monkeypatch)
    assert max(pose.gap(step)) < 0.003
    assert searches == 0


@pytest.mark.parametrize("limit", [{"sparse_points": 5000}, {"retry_below": 1.1}], ids=["few points", "poor match"])
def test_what_is_not_clear_is_searched_in_the_second_window(
    limit: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    robust = Config().robust
    config = replace(Config(), robust=replace(robust, expert=replace(robust.expert, **limit)))
    assert match_after(Pose(0.04, 0.01, 0.06), Motion(0.1), monkeypatch, config)[1] == 1
