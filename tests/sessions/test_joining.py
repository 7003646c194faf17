"""Sessions that overlap are joined whatever their order, and those of other buildings are not."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory
from mavnav.sessions import growth
from mavnav.sessions.closures import count_contradicting
from mavnav.sessions.group import Session, group_in_frame, make_session, merged_map, own_edges, trajectories
from mavnav.sessions.growth import join_sessions
from mavnav.slam.loop_closure.key_frames import KeyFrameMap
from support.sessions import CELLAR, TOURS, cut, errors_m, session, tour, twin_room
from support.synthetic import Recording

CONFIG = Config()


@pytest.fixture(scope="module")
def tours() -> dict[str, Recording]:
    return {name: tour(name, seed) for seed, name in enumerate(TOURS)}


@pytest.fixture(scope="module")
def sessions(tours) -> dict[str, Session]:
    return {name: session(name, recording) for name, recording in tours.items()}


def silent(*_: object) -> None:
    """Report nothing."""


def test_overlapping_sessions_are_joined_to_one_map(tours, sessions) -> None:
    group, refused = join_sessions([sessions[name] for name in ("both", "back", "hall")], CONFIG, silent)
    assert refused == []
    assert {s.name for s in group.sessions} == set(TOURS)
    assert all(join.closures > 2 * join.contradicting for join in group.joins[1:])
    assert all(join.residual_m < 0.02 for join in group.joins)
    world_T_group = tours[group.sessions[0].name].world_T_laser[0]
    placed = trajectories(group)
    grid, refined = merged_map(group, CONFIG, [0], silent)
    for poses in (placed, [member.map_T_laser for member in refined]):
        members = zip(group.sessions, poses, strict=True)
        assert max(errors_m(path, tours[member.name], world_T_group) for member, path in members) < 0.03
    assert np.count_nonzero(grid.hits) > 500


def test_parts_of_a_recording_are_joined_one_after_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those named before the part that they go on with were searched in the whole map: 30 parts took 99 s, not 69."""
    monkeypatch.delattr(growth, "locate_session")
    parts = [session(f"part{k}", recording) for k, recording in enumerate(cut(tour("both"), 4))]
    group, refused = join_sessions(parts[::-1], CONFIG, silent)
    assert refused == []
    assert [member.name for member in group.sessions] == [part.name for part in parts]


@pytest.mark.slow
def test_a_doubtful_track_bends_no_other(tours, sessions) -> None:
    """It is 0.3 m off at its end, where it must fit the others."""
    back = tours["back"].map_T_laser
    bent = Trajectory(back.stamps_ns, back.xyyaw + np.linspace(0, 1, len(back))[:, None] * (0.2, 0.2, 0.05))
    doubtful = make_session("back", lambda: tours["back"].scans, bent, CONFIG, doubtful=True)
    group, refused = join_sessions([doubtful, sessions["both"], sessions["hall"]], CONFIG, silent)
    assert refused == []
    assert [s.name for s in group.sessions[1:]][-1] == "back"
    alone, _ = join_sessions([sessions["both"], sessions["hall"]], CONFIG, silent)
    for path, before in zip(trajectories(group), trajectories(alone), strict=False):
        np.testing.assert_array_equal(path.xyyaw, before.xyyaw)
    world_T_group = tours[group.sessions[0].name].world_T_laser[0]
    assert errors_m(trajectories(group)[-1], tours["back"], world_T_group) < 0.1


@pytest.mark.slow
def test_another_building_does_not_join(sessions) -> None:
    other = session("cellar", tour("hall", 7, CELLAR))
    group, (refused,) = join_sessions([other, sessions["hall"], sessions["back"]], CONFIG, silent)
    assert {s.name for s in group.sessions} == {"hall", "back"}
    assert (refused.name, refused.closures) == ("cellar", 0)
    assert refused.why == "too few scans of the others fit in its map"


def test_rooms_that_look_alike_are_not_joined() -> None:
    """The walls of the corridor beside them contradict it."""
    one, other = (session(name, twin_room(x_m)) for name, x_m in (("one", 0.0), ("other", 5.0)))
    group, (refused,) = join_sessions([one, other], CONFIG, silent)
    assert len(group.sessions) == 1
    assert refused.agreeing >= 3
    assert refused.why == "too many of its scans contradict the others' map"


def test_key_frames_in_the_wrong_place_contradict_the_map(sessions) -> None:
    hall = sessions["hall"]
    part = KeyFrameMap(CONFIG)
    part.grow(hall.keys, len(hall.keys))
    assert count_contradicting(hall.keys, part) == 0
    wrong = [replace(key, map_T_laser=Pose(0.9, 0.5, 0.4) @ key.map_T_laser) for key in hall.keys]
    assert count_contradicting(wrong, part) > len(hall.keys) / 2


def test_a_session_that_came_back_is_held_together(sessions) -> None:
    """Besides the edges of the path there are some between key frames that lie near after a long path."""
    keys = sessions["hall"].keys
    assert len(list(own_edges(sessions["hall"], 0))) == len(keys) - 1
    back = [replace(key, path_m=key.path_m + 20.0) for key in keys]
    edges = list(own_edges(replace(sessions["hall"], keys=(*keys, *back)), 5))
    assert len(edges) == 2 * len(keys) - 1 + len(keys)
    assert min(edge.start for edge in edges) == 5
    assert group_in_frame([sessions["hall"]]).owner(0) == 0


def test_scans_of_another_run_are_refused(tours) -> None:
    late = replace(tours["hall"].scans[3], stamp_ns=5)
    scans = [*tours["hall"].scans[:3], late, *tours["hall"].scans[4:]]
    with pytest.raises(ValueError, match="another time"):
        make_session("hall", lambda: scans, tours["hall"].map_T_laser, CONFIG)
