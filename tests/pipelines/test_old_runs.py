"""Runs of version 0.2.0, whose configuration had the keys of experts among the others, are repeated and continued."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import mavnav as api
from mavnav.config.loading import load_config
from mavnav.pipelines.again import earlier_run, replay_again, run_layer, simulation_again
from mavnav.simulation.world.scenario_file import load_scenario

SETTINGS = {"robust.expert.truncate_mm": 140, "robust.cell_mm": 25, "paper.expert.shrink": 0.4}


def flat(config: dict) -> dict:
    """Return a configuration as version 0.2.0 wrote it."""
    sections = {name: dict(config[name]) for name in ("paper", "robust")}
    return config | {name: section.pop("expert") | section for name, section in sections.items()}


@pytest.fixture(scope="module")
def old_run(tmp_path_factory: pytest.TempPathFactory, repo_root: Path) -> Path:
    run = tmp_path_factory.mktemp("runs") / "old"
    api.replay(repo_root / "sample_logs" / "corridor.mcap", directory=run, end_s=1, settings=SETTINGS)
    rewrite(run, config=flat(json.loads((run / "run.json").read_text())["config"]))
    return run


def rewrite(run: Path, **sections: object) -> None:
    (run / "run.json").write_text(json.dumps(json.loads((run / "run.json").read_text()) | sections))


def test_its_configuration_is_read(old_run: Path) -> None:
    written = load_config(sets=[f"{key}={value}" for key, value in SETTINGS.items()])
    assert replay_again(earlier_run(old_run, simulated=False), None)["config"] == written
    assert load_config(values=run_layer(old_run)) == written


def test_a_wrong_value_is_named_by_its_key_of_now(old_run: Path) -> None:
    config = json.loads((old_run / "run.json").read_text())["config"]
    config["robust"]["truncate_mm"] = -1
    rewrite(old_run, config=config)
    with pytest.raises(
        api.errors.ConfigError, match=r"run.json:1: robust.expert.truncate_mm is -1, it should be greater"
    ):
        replay_again(earlier_run(old_run, simulated=False), None)


def test_its_scenario_is_read(tmp_path: Path) -> None:
    scenario = load_scenario("corner", ["slam.robust.expert.truncate_mm=140", "max_steps=2"])
    api.simulate("corner", directory=tmp_path / "m", settings={"slam.robust.expert.truncate_mm": 140, "max_steps": 2})
    document = scenario.document()
    rewrite(tmp_path / "m", scenario=document | {"slam": flat(document["slam"])})
    assert simulation_again(earlier_run(tmp_path / "m", simulated=True))["scenario"] == scenario
