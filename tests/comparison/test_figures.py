"""Who wins, and what it costs."""

from __future__ import annotations

from typing import Any

from mavnav.comparison.document import best, one_best, relative_costs
from mavnav.outputs.documents.quantities import QUANTITIES


def run(p95: float | None = 100.0, *, cpu_s: float = 1.0, code: int = 0, cell_mm: float = 20.0, **more: Any) -> dict:
    return {
        "exit_code": code,
        "map": {"accepted_share": 1.0, "cell_mm": cell_mm},
        "wall_thickness": {"spread": {"p95_mm": p95}, "paper_cells": {"max": 10.0}},
        "search": {"evaluations_per_scan": {"mean": 1000.0 * cpu_s}},
        "timing": {"cpu_s": cpu_s, "wall_s": 2 * cpu_s},
        **more,
    }


def quality(*, meaningful: bool = True, cells_per_m: float | None = None) -> dict[str, Any]:
    return {"meaningful": meaningful, "crispness": {"occupied_cells_per_m": cells_per_m}}


def winners(runs: list) -> dict[str, int | None]:
    return one_best(runs)


P95, CPU, EVALUATIONS, MAPPED, CELLS = (
    "wall_thickness.spread.p95_mm",
    "timing.cpu_s",
    "search.evaluations_per_scan.mean",
    "map.accepted_share",
    "map_quality.crispness.occupied_cells_per_m",
)


def test_the_least_or_the_most_wins() -> None:
    found = winners([run(100, cpu_s=1), run(60, cpu_s=2), run(90, cpu_s=3)])
    assert (found[P95], found[EVALUATIONS], found[MAPPED]) == (1, 0, None)
    assert set(found) == {quantity.name for quantity in QUANTITIES}
    mapped = [run(map={"accepted_share": share, "cell_mm": 20}) for share in (0.6, 0.9)]
    assert winners(mapped)[MAPPED] == 1


def test_equals_share_the_place_and_of_all_equal_nobody_has_it() -> None:
    assert best([run(100), run(80), run(80)])[P95] == [1, 2]
    assert winners([run(80), run(80)])[P95] is None


def test_what_reads_the_same_is_the_same() -> None:
    assert winners([run(cpu_s=1.0001), run(cpu_s=1.0004)])[EVALUATIONS] is None
    assert winners([run(cpu_s=1.006), run(cpu_s=1.004)])[EVALUATIONS] == 1


def test_a_time_that_was_measured_once_is_not_ranked() -> None:
    assert winners([run(cpu_s=1.0), run(cpu_s=2.0)])[CPU] is None


def test_differences_up_to_the_noise_are_none() -> None:
    assert winners([run(100), run(96)])[P95] is None
    assert winners([run(100), run(91)])[P95] == 1
    assert best([run(150), run(100), run(96)])[P95] == [1, 2]


def test_failed_lost_and_meaningless_maps_never_win() -> None:
    empty = run(1, map_quality=quality(meaningful=False))
    found = winners([None, run(2, code=5), empty, run(None), run(60), run(95)])
    assert found[P95] == 4
    assert set(winners([None, empty]).values()) == {None}


def test_nobody_wins_alone() -> None:
    assert set(winners([run()]).values()) == {None}


def test_damaged_input_may_win() -> None:
    assert winners([run(100), run(80, code=3)])[P95] == 1


def test_cells_of_another_size_are_not_counted_against_each_other() -> None:
    runs = [run(map_quality=quality(cells_per_m=60)), run(map_quality=quality(cells_per_m=50))]
    assert winners(runs)[CELLS] == 1
    runs[1]["map"]["cell_mm"] = 14
    assert winners(runs)[CELLS] is None


def test_walls_of_maps_with_other_cells_are_not_compared() -> None:
    assert winners([run(60), run(40)])[P95] == 1
    assert winners([run(60), run(40, cell_mm=14.0)])[P95] is None


def test_maps_of_one_cell_size_are_ranked_among_themselves() -> None:
    runs = [run(100), run(60), run(90, cell_mm=14.0), run(50, cell_mm=14.0), run(10, cell_mm=50.0)]
    assert best(runs)[P95] == [1, 3]  # the only map with cells of 50 mm competes with none
    assert winners(runs)[P95] is None


def test_relative_costs_are_ratios_to_the_coarsest_of_the_group() -> None:
    groups = [("a", 440), ("a", 35), ("b", 35), ("b", 120), ("c", 35)]
    found = relative_costs(groups, [run(cpu_s=6), run(cpu_s=2), None, run(cpu_s=5), None])
    assert found["coarsest"] == [1, 1, 3, 3, None]
    assert found["cpu"] == [3.0, 1.0, None, 1.0, None]
    assert found["evaluations"] == found["seconds"] == found["cpu"]


def test_nothing_is_divided_by_zero() -> None:
    assert relative_costs([("a", 1), ("a", 2)], [run(cpu_s=0), run(cpu_s=1)])["cpu"] == [None, None]
