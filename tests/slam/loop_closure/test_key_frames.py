"""The path to an old place is shorter across a place where the track holds."""

from __future__ import annotations

from mavnav.slam.loop_closure.key_frames import shortest_path


def test_one_closure_shortens_a_path() -> None:
    assert shortest_path(10.0, 90.0, []) == 80.0
    assert shortest_path(10.0, 90.0, [(12.0, 85.0)]) == 7.0
    assert shortest_path(10.0, 90.0, [(60.0, 85.0), (9.0, 89.5)]) == 1.5
    assert shortest_path(10.0, 12.0, [(40.0, 85.0)]) == 2.0
