"""Fixtures that every test may use: a finished comparison, and the real recordings; what processes of tests share."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.main
from hypothesis import settings

ROOT = Path(__file__).parent.parent

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # or each process that tests start compiles all modules again
sys.dont_write_bytecode = False

gc.disable()


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile all kernels, also those of tests, before several processes would compile the same ones at once."""
    if session.config.getoption("numprocesses", None):
        paths = os.pathsep.join((str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")))
        code = "import support.kernel_parts; from mavnav.cli import run; run(['warmup'])"
        environment = os.environ | {"PYTHONPATH": paths}
        subprocess.run([sys.executable, "-c", code], env=environment, stdout=subprocess.DEVNULL, check=False)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep the tests of a file in one process, which makes their fixtures once."""
    from xdist.scheduler import LoadFileScheduling

    return LoadFileScheduling(config, log)


def pytest_collection_finish() -> None:
    """Collect garbage from here on, but never look again at what was made so far: thousands of tests."""
    gc.freeze()
    gc.enable()


settings.register_profile("few", deadline=None, max_examples=30)
settings.register_profile("many", deadline=None)


def pytest_configure(config: pytest.Config) -> None:
    """Try as many examples as hypothesis does by default only where the slow tests run, too."""
    settings.load_profile("few" if config.option.markexpr else "many")


@pytest.fixture(scope="session")
def repo_root() -> Path:
    return ROOT


@pytest.fixture(scope="session", autouse=True)
def _commands() -> Iterator[None]:
    """Build the options of each command once a process, as for a user, not for each line of a test: 10 to 40 ms."""
    from mavnav import cli

    build, apps = cli.app_for, {}

    def app_for(args: Sequence[str]) -> typer.Typer:
        wanted = next((arg for arg in args if not arg.startswith("-")), "")
        return apps[wanted] if wanted in apps else apps.setdefault(wanted, build(args))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli, "app_for", app_for)
        patch.setattr(typer.main, "get_command", cache(typer.main.get_command))
        yield


@pytest.fixture(scope="session")
def sample(repo_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the first 42 scans of a sample log, of which the rest would take longer to read than most replays take."""
    from support.log_files import copy_messages

    path = tmp_path_factory.mktemp("sample") / "corridor.mcap"
    copy_messages(repo_root / "sample_logs" / "corridor.mcap", path, lambda topic, scans: [topic] * (scans <= 42))
    return path


SHORT_COMPARISON = ("--end", "0.5", "--online", "--set", "azimuth=6", "--grid", "5x5", "--grid", "12x12")


@pytest.fixture(scope="session")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the directory of a finished comparison of two short replays of a sample log; for reading."""
    from mavnav.cli import run

    target = tmp_path_factory.mktemp("comparisons") / "first"
    log = ROOT / "sample_logs" / "corridor.mcap"
    assert run(["compare", str(log), "-o", str(target), "-q", *SHORT_COMPARISON]) == 0
    return target


@pytest.fixture(scope="session")
def real_logs() -> Path:
    """Return the folder of the real recordings; skip without it, or fail where they are required."""
    folder = Path(os.environ.get("MAVNAV_REAL_LOGS") or ROOT.parent / "shared" / "logs")
    if folder.is_dir():
        return folder
    reason = f"no real recordings at {folder}; set MAVNAV_REAL_LOGS"
    if os.environ.get("MAVNAV_REQUIRE_REAL_LOGS") == "1":
        pytest.fail(reason)
    pytest.skip(reason)
