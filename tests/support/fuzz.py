"""Mutations of logs, and checks of how they are read.

    PYTHONPATH=tests python -m support.fuzz [CASES [SEED [LOG ...]]]

The logs are the small ones of `log_files`, or those given.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from mavnav.errors import NoScansError, TopicError
from mavnav.logs import Log, choose, survey
from support.log_files import WRITERS, laser

if TYPE_CHECKING:
    from collections.abc import Callable

CHECKED = {"mcap-none", "mcap-lz4", "mcap-zstd", "mcap-unchunked", "mcap-ros1", "bag1-bz2"}
"""Logs whose chunks have a checksum, so that every altered scan must be reported."""

DATA_END = b"\x0f" + (4).to_bytes(8, "little")

FILES = [name for name in WRITERS if not name.startswith("bag2")]


def _flip(rng: np.random.Generator, data: bytearray) -> None:
    for at in rng.integers(0, len(data), rng.integers(1, 9)):
        data[at] ^= 1 << int(rng.integers(8))


def _cut(rng: np.random.Generator, data: bytearray) -> None:
    del data[int(rng.integers(len(data))) :]


def _span(rng: np.random.Generator, data: bytearray) -> slice:
    start = int(rng.integers(len(data)))
    return slice(start, start + int(2 ** rng.uniform(0, 13)))


def _zero(rng: np.random.Generator, data: bytearray) -> None:
    span = _span(rng, data)
    data[span] = bytes(len(data[span]))


def _noise(rng: np.random.Generator, data: bytearray) -> None:
    span = _span(rng, data)
    data[span] = rng.bytes(len(data[span]))


def _lose(rng: np.random.Generator, data: bytearray) -> None:
    del data[_span(rng, data)]


def _gain(rng: np.random.Generator, data: bytearray) -> None:
    at = int(rng.integers(len(data)))
    data[at:at] = rng.bytes(int(2 ** rng.uniform(0, 10)))


def _repeat(rng: np.random.Generator, data: bytearray) -> None:
    at = int(rng.integers(len(data)))
    data[at:at] = data[_span(rng, data)]


def _lie(rng: np.random.Generator, data: bytearray) -> None:
    """Overwrite bytes, which may be a length, by another number."""
    number = [0, 1, 0x7F, 0xFFFF, 1 << 24, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 64) - 1][rng.integers(9)]
    width = [2, 4, 8][rng.integers(3)]
    at = int(rng.integers(len(data)))
    data[at : at + width] = (number % (1 << 8 * width)).to_bytes(width, ["little", "big"][rng.integers(2)])


def _crlf(rng: np.random.Generator, data: bytearray) -> None:
    data[:] = data.replace(b"\r\n", b"\n") if rng.integers(2) else data.replace(b"\n", b"\r\n")


def _join(rng: np.random.Generator, data: bytearray) -> None:
    data += bytes(data[int(rng.integers(len(data))) :] if rng.integers(2) else data)


MUTATIONS: list[Callable[[np.random.Generator, bytearray], None]] = [
    _flip, _flip, _flip, _cut, _zero, _noise, _lose, _gain, _repeat, _lie, _lie, _lie, _crlf, _join,
]  # fmt: skip


class Verdict(Struct, frozen=True):
    """Result of a case: its scans, those that differ from the valid log, and whether anything was reported."""

    scans: int
    altered: int
    suspect: int
    reported: bool
    seconds: float


def mutated(data: bytes, seed: int) -> bytes:
    rng = np.random.default_rng(seed)
    copy = bytearray(data)
    for _ in range(int(rng.integers(1, 3))):
        if copy:
            MUTATIONS[rng.integers(len(MUTATIONS))](rng, copy)
    return bytes(copy)


def is_guarded(name: str, sound: bytes, damaged: bytes) -> bool:
    """Return whether a checksum covers every scan; without chunks it follows the data."""
    at = sound.rfind(DATA_END)
    return name in CHECKED and (name != "mcap-unchunked" or sound[at : at + 13] in damaged)


def contents(log: Log) -> dict[int, bytes]:
    return {s.stamp_ns: s.ranges_m.tobytes() for s in log.scans()}


def verdict(path: Path, sound: dict[int, bytes]) -> Verdict:
    """Read a damaged log; exceptions other than the documented ones are findings."""
    began_s = time.process_time()
    scans: dict[int, bytes] = {}
    suspect = 0
    found = survey(path)
    reported = bool(found.damage or found.warnings)
    for topic in found.scans:
        try:
            log = choose(found, topic=topic)
        except (NoScansError, TopicError):
            continue
        here = contents(log)
        assert len(here) == log.counts.usable, "the second reading differs from the first"
        assert log.counts.total == log.counts.usable + sum(log.counts.skipped.values()), "a scan is not counted"
        reported |= bool(log.warnings)
        suspect += log.counts.suspect
        scans |= here if log.stamp_source == "header" else {}
    altered = sum(sound.get(stamp) != ranges for stamp, ranges in scans.items())
    return Verdict(len(scans), altered, suspect, reported, time.process_time() - began_s)


def _seeds(folder: Path, named: list[str]) -> dict[str, Path]:
    if named:
        return {name: Path(name) for name in named}
    scans = [laser(k, beams=64) for k in range(60)]
    return {name: WRITERS[name][1](folder / name, scans) for name in FILES}


def main(cases: int, seed: int, named: list[str]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for format_, source in _seeds(folder, named).items():
            data, sound = source.read_bytes(), contents(choose(survey(source)))
            worst, unreported, read = 0.0, 0, 0
            for case in range(cases):
                path = folder / "case"
                damaged = mutated(data, seed + case)
                path.write_bytes(damaged)
                guarded = source.suffix == ".mcap" or is_guarded(format_, data, damaged)
                try:
                    result = verdict(path, sound)
                except Exception as error:
                    print(f"{format_}, seed {seed + case}: {type(error).__name__}: {error}")
                    continue
                if guarded and result.altered > result.suspect:
                    print(f"{format_}, seed {seed + case}: {result}")
                    unreported += 1
                worst, read = max(worst, result.seconds), read + result.scans
            share = read / (cases * len(sound))
            print(f"{format_}: {cases} cases, {share:.3f} of scans read, {unreported} unreported, worst {worst:.2f} s")
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main(int(sys.argv[1] if sys.argv[1:] else 1000), int(sys.argv[2] if sys.argv[2:] else 0), sys.argv[3:])
