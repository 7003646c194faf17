"""Chromium as the tests of pages use it, or the reason why it is not there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
)  # fmt: skip
WAIT_S = 30.0


@contextmanager
def browser(folder: Path, *, dark: bool = False) -> Iterator[object]:
    """Yield a driver of Chromium with a new profile; skip, or fail where MAVNAV_REQUIRE_BROWSER is 1, without one."""
    programs = [shutil.which(name) for name in ("chromium", "chromedriver")]
    if None in programs:
        complain = pytest.fail if os.environ.get("MAVNAV_REQUIRE_BROWSER") == "1" else pytest.skip
        complain("no browser: apt-get install chromium chromium-driver")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = programs[0]
    dark_theme = ["--blink-settings=preferredColorScheme=0"] if dark else []
    for word in (*QUIET, "--window-size=1400,1000", f"--user-data-dir={folder}", *dark_theme):
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(programs[1]))
    try:
        yield driver
    finally:
        driver.quit()
