"""Some mutated logs of each format: nothing but the refusals we mean, quickly, and no altered scan unmarked.

``make fuzz`` reads thousands of them, ``.ci/run`` hundreds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mavnav.logs import choose, survey
from support import fuzz
from support.log_files import WRITERS, laser

if TYPE_CHECKING:
    from pathlib import Path

CASES = 12


@pytest.mark.parametrize("name", fuzz.FILES)
def test_mutated_logs_are_read_or_refused(name: str, tmp_path: Path) -> None:
    source = WRITERS[name][1](tmp_path / "source", [laser(k, beams=16) for k in range(30)])
    data, sound = source.read_bytes(), fuzz.contents(choose(survey(source)))
    case, kept = tmp_path / "case", 0
    for seed in range(CASES):
        damaged = fuzz.mutated(data, seed)
        case.write_bytes(damaged)
        result = fuzz.verdict(case, sound)
        assert result.seconds < 5.0, seed
        if fuzz.is_guarded(name, data, damaged):
            assert result.altered <= result.suspect, seed
        assert result.reported or result.scans >= len(sound) or name not in fuzz.CHECKED, seed
        kept += result.scans
    assert kept > 0.25 * CASES * len(sound)
