"""What is written of a mission of a vehicle that tilts, and that its recording gives the same again."""

from __future__ import annotations

import csv
import json
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
from msgspec import convert

from mavnav.ground_truth.references import of_scenario
from mavnav.logs import open_log
from mavnav.outputs.report.charts import curves
from mavnav.outputs.report.entry import load
from mavnav.outputs.report.page import single
from mavnav.outputs.run import RunResult
from mavnav.pipelines.simulate import SimulationRequest, simulate_mission
from mavnav.pose import Pose
from mavnav.simulation.world.scenario import Scenario
from mavnav.simulation.world.scenario_file import load_scenario, scenario_path
from mavnav.units import DEG

if TYPE_CHECKING:
    from pathlib import Path

SCANS = 20


class Flown(NamedTuple):
    """A mission of some steps with its files."""

    scenario: Scenario
    run: RunResult
    document: dict[str, Any]
    folder: Path


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    home = tmp_path_factory.mktemp("hover")
    scenario = load_scenario("hover", ["flight.tilt_noise_deg=8", f"max_steps={SCANS - 1}"])
    request = SimulationRequest(
        scenario,
        scenario_path("hover"),
        home / "run",
        recording=home / "flight.mcap",
        animation=home / "flight.gif",
        outputs=("trajectory", "map", "metrics"),
    )
    return Flown(scenario, *simulate_mission(request, lambda *_: None, 0.0), home)


def test_the_mission_tells_height_tilt_and_whether_it_used_them(flown: Flown) -> None:
    mission = flown.document["mission"]
    assert (mission["flight_height_m"], mission["attitude_used"]) == (1.1, True)
    assert 5 < mission["tilt_p95_deg"] < 35
    assert 0 < mission["height_error_p95_m"] < 0.08
    assert flown.document["input"]["attitude"]["topic"] == "/attitude"
    assert flown.document["input"]["attitude"]["ceiling_m"] == 2.6
    assert len(flown.document["slices"]) > 2
    assert convert(flown.document["scenario"], Scenario) == flown.scenario


def test_planar_missions_have_no_word_of_it() -> None:
    document = load_scenario("corner").document()
    assert not {"flight", "ceiling_m"} & set(document)
    assert "height_m" not in json.dumps(document)


def test_the_recording_levels_as_the_flight_did(flown: Flown) -> None:
    log = open_log(flown.folder / "flight.mcap")
    assert log.attitude is not None
    assert len(log.attitude.stamps_ns) == SCANS
    for ours, theirs in zip(flown.run.log.scans(), log.scans(), strict=True):
        assert ours.heights_m is not None
        assert theirs.heights_m is not None
        both = np.isfinite(ours.ranges_m) & np.isfinite(theirs.ranges_m)
        assert both.mean() > 0.4
        np.testing.assert_allclose(ours.ranges_m[both], theirs.ranges_m[both])
    level = open_log(flown.folder / "flight.mcap", attitude="off")
    assert level.attitude is None
    assert all(scan.heights_m is None for scan in level.scans())


def test_the_attitude_of_every_scan_is_in_the_table_and_drawn(flown: Flown) -> None:
    with (flown.folder / "run" / "trajectory.csv").open(encoding="ascii", newline="") as file:
        rows = list(csv.DictReader(file))
    heights = [float(row["height_m"]) for row in rows]
    assert len(rows) == SCANS
    assert np.mean(heights) == pytest.approx(1.1, abs=0.03)
    assert max(abs(float(row["roll_rad"])) for row in rows) > 3 * DEG
    entry = load(single(flown.document)["cells"][0], flown.folder / "run")
    assert [*curves(entry)][-3:] == ["roll [deg]", "pitch [deg]", "height [m]"]
    assert (flown.folder / "flight.gif").stat().st_size > 1000


def test_the_true_map_is_the_slice_at_flight_height(flown: Flown) -> None:
    walls = json.loads((flown.folder / "run" / "true_walls.json").read_text())
    assert len(walls["segments"]) == len(flown.scenario.obstacles.segments) < len(flown.scenario.world.segments)
    true_map = of_scenario(flown.scenario, Pose())
    on_table, beside = np.array(flown.scenario.via_m[:1]), np.array([[2.9, 3.3]])
    assert true_map.distance_m(on_table)[0] == 0.0
    assert true_map.distance_m(beside)[0] > 0.2
    assert np.hypot(*(true_map.xy_m - on_table).T).min() > 0.5
    assert flown.document["reference"]["map_distance"]["median_mm"] < 60
