"""Measure how much of damaged logs is recovered, and check that all damage is reported.

    python benchmarks/fuzz_logs.py [--seed S] [--count N] [--attacks N] [--seconds T] [--logs NAME ...] [--verbose]

Small logs of every container are mutated, ``N`` times in all, and read back. Scans are compared by content, bit for
bit. A scan is intact if its bytes are unchanged in the file: the content of its chunk, or its own record outside of
chunks. Counted per container:

- recovered: intact scans that are read, over all intact scans (containers with chunks or records);
- unmarked: altered scans that are not suspect, although a checksum covers them; must be 0;
- strict: altered scans that ``--strict`` keeps, although a checksum covers them; must be 0;
- silent: cases with altered scans and neither damage nor a warning; must be 0 if a checksum covers them;
- invented: topics that the valid log does not have, while the name of the real one (in MCAP with its length) is in the
  file; duplicated: a scan twice on one topic and not suspect; must be 0;
- errors: exceptions other than the documented ones (exit code 70); slow: more than 20 s of CPU; must be 0.

With ``--attacks``, hostile logs (`log_attacks`) are read by a command in a forked child, as in `fuzz_inputs`; the
problems counted there must be 0 too.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import zstandard
from mcap.writer import IndexType
from msgspec import Struct, field

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import log_attacks
from mcap.opcode import Opcode as Op

from mavnav import cli
from mavnav.errors import NoScansError, TopicError
from mavnav.logs import Log, choose, survey
from mavnav.logs.formats.decompress import decompress
from mavnav.logs.formats.mcap_records import HEAD, MAGIC, chunk_head, plain_records
from support.fuzz import CHECKED, is_guarded, mutated
from support.log_files import WRITERS, foxglove_json, foxglove_protobuf, laser, write_mcap
from support.sandbox import COUNTED as ATTACK_COUNTED
from support.sandbox import problems, table_row

SAMPLES = Path(__file__).parent.parent / "sample_logs"
MAX_CPU_S = 20.0
Scan = tuple[int, bytes]


class Seed(Struct):
    """A valid log: ``parts`` are the byte sequences that contain scans, each with the indices of its scans."""

    name: str
    data: bytes
    suffix: str
    packed: bool = False
    scans: list[Scan] = field(default_factory=list)
    topics: set[str] = field(default_factory=set)
    parts: list[tuple[bytes, list[int]]] = field(default_factory=list)
    heads: bool = False

    @property
    def checked(self) -> bool:
        return self.name in CHECKED or self.name in {
            "sample",
            "json",
            "protobuf",
            "mcap-nosummary",
            "mcap-large",
            "mcap-file-zstd",
        }


def read_scans(path: Path, *, strict: bool) -> tuple[list[tuple[str, Log]], bool]:
    """Return the logs of the usable scan topics, and whether damage or a warning is reported."""
    found = survey(path, strict=strict)
    logs, marked = [], bool(found.damage or found.warnings)
    for topic in found.scans:
        try:
            logs.append((topic, choose(found, topic=topic)))
        except (NoScansError, TopicError):
            continue
    return logs, marked


def contents(log: Log) -> list[Scan]:
    by_header = log.stamp_source == "header"
    return [(scan.stamp_ns if by_header else -1, scan.ranges_m.tobytes()) for scan in log.scans()]


def make_seeds(folder: Path, wanted: list[str]) -> list[Seed]:
    seeds = []
    scans = [laser(k, beams=64) for k in range(60)]
    for name, (kind, write) in WRITERS.items():
        if not name.startswith("bag2"):
            path = write(folder / name, scans)
            seeds.append(Seed(name, path.read_bytes(), ".mcap" if "mcap" in kind else "", name == "mcap-file-zstd"))
    fox = [
        {
            "timestamp": {"sec": 1_700_000_000 + k, "nsec": 5}, "frame_id": "laser", "start_angle": -1.0,
            "end_angle": 1.0, "ranges": np.random.default_rng(k).uniform(0.5, 9.0, 64).tolist(),
        }
        for k in range(60)
    ]  # fmt: skip
    parts = ("summary_offsets", "statistics")
    nothing = dict.fromkeys((*(f"use_{part}" for part in parts), "repeat_channels", "repeat_schemas"), False)
    large = [laser(k, beams=681) for k in range(48)]
    for name, path in (
        ("json", foxglove_json(folder / "json", fox, chunk_size=9000)),
        ("protobuf", foxglove_protobuf(folder / "protobuf", fox, chunk_size=5000)),
        ("mcap-nosummary", write_mcap(folder / "nosummary", scans, index_types=IndexType.NONE, **nothing)),
        ("mcap-large", write_mcap(folder / "large", large, compression="NONE", chunk_size=24000)),
    ):
        seeds.append(Seed(name, path.read_bytes(), ".mcap"))
    seeds.append(Seed("sample", (SAMPLES / "corridor.mcap").read_bytes(), ".mcap"))
    seeds = [seed for seed in seeds if not wanted or seed.name in wanted]
    for seed in seeds:
        _measure(seed, folder)
    return seeds


def _measure(seed: Seed, folder: Path) -> None:
    path = folder / f"sound{seed.suffix}"
    path.write_bytes(seed.data)
    logs, _ = read_scans(path, strict=False)
    assert len(logs) == 1, seed.name
    seed.topics.add(logs[0][0])
    seed.scans = contents(logs[0][1])
    plain = unpacked(seed.data) if seed.packed else seed.data
    if plain.startswith(MAGIC):
        seed.parts = list(_mcap_parts(plain))
        seed.heads = not seed.packed
    assert not seed.parts or sum(len(numbers) for _, numbers in seed.parts) == len(seed.scans), seed.name


def unpacked(data: bytes) -> bytes:
    """Return the content of a zstd file up to the first damage."""
    blocks = []
    with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as stream:
        try:
            while block := stream.read(256):
                blocks.append(block)
        except zstandard.ZstdError:
            pass
    return b"".join(blocks)


def heads(data: bytes) -> list[tuple[int, int]]:
    """Return the offsets and content lengths of the records of an MCAP file, up to the first incomplete head."""
    offset, found = len(MAGIC), []
    while offset + HEAD.size <= len(data):
        _, length = HEAD.unpack_from(data, offset)
        found.append((offset, length))
        offset += HEAD.size + length
    return found


def damaged_anywhere(seed: Seed, number: int) -> bytes:
    """Damage a log at random offsets, as a bad disk, a bad copy or a faulty writer does."""
    return mutated(seed.data, number)


def damaged_records(seed: Seed, number: int) -> bytes:
    """Damage heads, first fields or contents of one or two records."""
    rng = np.random.default_rng((number, 77))
    data = bytearray(seed.data)
    if not seed.heads:
        return mutated(seed.data, number)
    records = [(at, length) for at, length in heads(seed.data) if length > 64 or rng.random() < 0.1]
    for at, length in [records[k] for k in rng.integers(0, len(records), rng.integers(1, 3))]:
        kind = int(rng.integers(6))
        place = at + int(rng.integers(HEAD.size if kind == 0 else 60 if kind == 1 else HEAD.size + length))
        place = min(place, len(data) - 1)
        size = int(2 ** rng.uniform(0, 12)) if rng.random() < 0.5 else 1
        if kind < 3:
            data[place] ^= 1 << int(rng.integers(8))
        elif kind == 3:
            del data[place : place + size]
        elif kind == 4:
            data[place:place] = data[place : place + size]
        else:
            data[place : place + size] = (b"\xff" if rng.random() < 0.5 else rng.bytes(1)) * min(
                size, len(data) - place
            )
    return bytes(data)


def _mcap_parts(data: bytes) -> Iterator[tuple[bytes, list[int]]]:
    """Yield the contents of chunks, and the message records outside of chunks, with the indices of their scans."""
    number, laser_ids = 0, set()

    def is_scan(opcode: int, content: bytes) -> bool:
        if opcode == Op.CHANNEL and b"can" in content:
            laser_ids.add(content[:2])
        return opcode == Op.MESSAGE and content[:2] in laser_ids

    for opcode, content in plain_records(data[len(MAGIC) :]):
        if opcode == Op.DATA_END:
            return
        if opcode == Op.CHUNK:
            head = chunk_head(content)
            records, _ = decompress(head.compression, content[head.start :])
            count = sum(is_scan(*record) for record in plain_records(records))
            yield content, list(range(number, number + count))
            number += count
        elif is_scan(opcode, content):
            yield HEAD.pack(opcode, len(content)) + content, [number]
            number += 1


class Case(Struct):
    """Counts and findings of one mutated log."""

    counts: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def note(self, what: str, count: int, text: str = "") -> None:
        self.counts[what] += count
        if count:
            self.notes.append(f"{what} {count} {text}")


def judge(seed: Seed, path: Path, damaged: bytes) -> Case:
    """Read a mutated log with and without ``--strict``, and count what is lost, altered and reported."""
    case = Case()
    began_s = time.process_time()
    try:
        logs, marked = read_scans(path, strict=False)
        read = [(topic, scan) for topic, log in logs for scan in contents(log)]
        suspect = sum(log.counts.suspect for _, log in logs)
        kept = [scan for _, log in read_scans(path, strict=True)[0] for scan in contents(log)]
    except Exception as error:  # any other exception is a finding
        case.note("errors", 1, f"{type(error).__name__}: {error}\n{traceback.format_exc()}")
        return case
    case.note("slow", int(time.process_time() - began_s > MAX_CPU_S))
    sound = set(seed.scans) | {(-1, ranges) for _, ranges in seed.scans}
    plain = unpacked(damaged) if seed.packed else damaged
    whole = {number for part, numbers in seed.parts if part in plain for number in numbers}
    out = {ranges for _, (_, ranges) in read}
    lost = [number for number in whole if seed.scans[number][1] not in out]
    case.counts["whole"] += len(whole)
    case.note("lost", len(lost), f"of {len(whole)}")
    altered = sum(scan not in sound for _, scan in read)
    guarded = seed.checked and (seed.name != "mcap-unchunked" or is_guarded(seed.name, seed.data, plain))
    case.counts["altered"] += altered
    if guarded:
        case.note("unmarked", max(altered - suspect, 0))
        case.note("strict", sum(scan not in sound for scan in kept))
        case.note("silent", int(altered > 0 and not marked))
    invented = {topic for topic, _ in logs if topic not in seed.topics and topic.startswith("/channel_")}
    named = any(declared(topic, plain) in plain for topic in seed.topics)
    case.note("invented", len(invented) if named else 0, f"{invented}")
    usual = Counter(ranges for _, ranges in seed.scans)
    for topic, _ in logs:
        here = Counter(ranges for name, (_, ranges) in read if name == topic)
        twice = sum((here - usual)[ranges] for ranges in usual)
        case.note("duplicated", max(twice - suspect, 0))
    return case


def declared(topic: str, plain: bytes) -> bytes:
    """Return the bytes of a topic's name in a log; in MCAP with its length, which is needed to read the record."""
    name = topic.encode()
    return len(name).to_bytes(4, "little") + name if plain.startswith(MAGIC) else name


COUNTED = "cases whole lost altered unmarked strict silent invented duplicated errors slow"
COLUMNS = {name: max(len(name), 6) + 1 for name in COUNTED.split()}
"""Name of a count -> width of its column, in characters."""

MUST_BE_ZERO = ("unmarked", "strict", "silent", "invented", "duplicated", "errors", "slow")


def row(log: str, counts: Counter[str]) -> str:
    """Return a line of the table."""
    share = f"{100 * (1 - counts['lost'] / counts['whole']):.3f}" if counts["whole"] else "-"
    return f"{log:18s}" + "".join(f"{counts[name]:>{width}d}" for name, width in COLUMNS.items()) + f"{share:>10s}"


def attack_logs(seed: int, count: int, end_s: float, kinds: list[str], *, verbose: bool) -> int:
    """Read hostile logs of all kinds by a command, in turn; return the number of findings."""
    names = [name for name in log_attacks.KINDS if not kinds or name in kinds]
    counts, began_s = {name: Counter[str]() for name in names}, time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        run = ["replay", str(SAMPLES / "corridor.mcap"), "-o", f"{name}/run", "--end", "0.2", "--json", "-q"]
        with redirect_stdout(StringIO()):
            assert cli.run(run) == 0, "the kernels, which the children inherit, are not loaded"
        for number in range(count):
            if time.monotonic() > end_s:
                break
            kind, rng = names[number % len(names)], np.random.default_rng((seed, number, 3))
            folder = Path(name) / "case"
            folder.mkdir()
            path = log_attacks.KINDS[kind](rng, folder)
            args = log_attacks.command(rng, kind, path)
            end, found = problems(args, folder)
            counts[kind] += Counter(["inputs", f"exit {end.code}", *(text.partition(":")[0] for text in found)])
            if found or verbose:
                about = f"{end.code}, {end.cpu_s:.1f} s, {end.memory_bytes >> 20} MB"
                print(f"  {kind} {number} {' '.join(args)}: {found} {about} {end.err[-300:]}", flush=True)
            shutil.rmtree(folder)
    total = sum(counts.values(), Counter[str]())
    for kind, found in (*counts.items(), ("all", total)):
        print(table_row(kind, found), " ".join(f"{k}: {n}" for k, n in sorted(found.items()) if k.startswith("exit ")))
    print(f"{total['inputs']} attacks of {len(names)} kinds in {time.monotonic() - began_s:.0f} s")
    return sum(total[what] for what in ATTACK_COUNTED)


def main() -> int:
    """Print a table of counts; return 1 if a count that must be 0 is not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000, help="mutated logs in all")
    parser.add_argument("--attacks", type=int, default=0, help="logs that are built, after the mutated ones")
    parser.add_argument("--kinds", nargs="*", default=[], help="kinds of attacks")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after this time")
    parser.add_argument("--logs", nargs="*", default=[], help="names of containers")
    parser.add_argument("-v", "--verbose", action="store_true", help="print every case with a finding")
    options = parser.parse_args()
    began_s = time.monotonic()
    share = options.seconds / 2 if options.attacks else options.seconds
    wrong = mutate_logs(options, began_s, share) if options.count else 0
    if options.attacks:
        end_s = began_s + options.seconds
        wrong += attack_logs(options.seed, options.attacks, end_s, options.kinds, verbose=options.verbose)
    return int(wrong > 0)


def mutate_logs(options: argparse.Namespace, began_s: float, seconds: float) -> int:
    """Print a line per container; return the number of findings."""
    total: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        seeds = make_seeds(folder, options.logs)
        print(f"{'log':18s}" + "".join(f"{name:>{width}s}" for name, width in COLUMNS.items()) + "  recovered %")
        for index, seed in enumerate(seeds):
            counts: Counter[str] = Counter()
            path = folder / f"case{seed.suffix}"
            end_s = began_s + seconds * (index + 1) / len(seeds)
            for number in range(options.seed + index, options.seed + options.count, len(seeds)):
                if time.monotonic() > end_s:
                    break
                attack = damaged_records if number // len(seeds) % 2 else damaged_anywhere
                damaged = attack(seed, number)
                path.write_bytes(damaged)
                case = judge(seed, path, damaged)
                counts += Counter(cases=1) + case.counts
                if options.verbose and case.notes:
                    print(f"  {seed.name} {number}: {'; '.join(case.notes)}")
            print(row(seed.name, counts), flush=True)
            total += counts
    print(row("all", total))
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    return sum(total[name] for name in MUST_BE_ZERO)


if __name__ == "__main__":
    sys.exit(main())
