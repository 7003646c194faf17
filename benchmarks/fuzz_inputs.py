"""Fuzz configurations, scenarios, manifests, maps, tables and results of earlier runs.

    python benchmarks/fuzz_inputs.py [--seed S] [--count N] [--seconds T] [--kinds NAME ...] [--verbose]

Valid files are mutated byte by byte, or a value in them is replaced: numbers with thousands of digits or out of range,
deep nesting, huge strings, aliases, tags, paths to devices, pipes and addresses. Images are replaced by pipes, devices,
bombs, or files with a wrong size. Each file is read by a command in a forked child. Problems are counted, and must be
0: tracebacks, exit code 70, crashes, hangs, over 20 s of CPU, over 1 GB of memory, changed inputs, and files outside of
the output.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import struct
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from msgspec import Struct

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from mavnav import cli
from support.fuzz import mutated
from support.sandbox import COUNTED, problems, table_row

ROOT = Path(__file__).parent.parent
SAMPLE = ROOT / "sample_logs" / "corridor.mcap"
SHORT = ("--end", "0.2", "--online", "--grid", "5x5", "--azimuth", "6", "-q")

CONTINUED = ("--end", "0.5", "-q")

Random = np.random.Generator


class Kind(Struct, frozen=True):
    """A file to attack, the commands that read it, of which one is chosen, and the function that replaces an image."""

    name: str
    file: str
    commands: tuple[tuple[str, ...], ...]
    picture: Callable[[Random, Path], None] | None = None


def png(width: int, height: int, colour: int, body: bytes) -> bytes:
    """Return a PNG file with this size and color type in its header, and any body."""
    head = struct.pack(">IIBBBBB", width, height, 8, colour, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", body), (b"IEND", b""))
    packed = (
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


def attack_picture(rng: Random, path: Path) -> None:
    """Replace the image of a map by a hostile file."""
    path.unlink()
    kind = int(rng.integers(12))
    side = int(rng.choice([0, 1, 9000, 9400, 20_000, 2**31 - 1]))
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.symlink_to(str(rng.choice(["/dev/zero", "/dev/full", "/dev/tty", "/proc/self/mem", "map.png"])))
    elif kind == 2:
        path.mkdir()
    elif kind == 3:
        with path.open("wb") as file:
            file.write(b"P5 30000 30000 255\n")
            file.truncate(int(rng.choice([2**20, 2**31, 2**38])))
    elif kind == 4:
        path.write_bytes(f"P{rng.choice([2, 5])} {side} {side} {rng.choice([0, 1, 255, 65535, 10**9])}\n0 0 0".encode())
    elif kind == 5:
        path.write_bytes(b"P2 2 2 255\n" + b"9" * 100_000 + b" 1 -1 1e9")
    elif kind == 6:
        path.write_bytes(b"P5 " + b"#" * 500_000 + b"\n" * 1000 + b"# x\n2 2 255\n1234")
    elif kind in {7, 8, 9}:
        rows, colours = min(side, 9400) or 1, {0: 1, 2: 3, 6: 4}
        colour = int(rng.choice(list(colours)))
        packer = zlib.compressobj(1)
        row = bytes(1 + rows * colours[colour])
        body = b"".join(packer.compress(row) for _ in range(rows if kind != 9 else 3)) + packer.flush()
        path.write_bytes(png(rows if kind == 7 else side, rows, colour, body))
    else:
        path.write_bytes(mutated(png(40, 40, 0, zlib.compress(bytes(41 * 40))), int(rng.integers(2**31))))


RUN_COMMANDS = (
    ("check", "run", "--gate", "map.accepted_share>=0.5"),
    ("metrics", "run"),
    ("diff", "run", "sound", "-q", "--report", "out/diff.html"),
    ("merge", "sound", "run", "-o", "out/merged", "-q"),
    ("merge", "run", "log.mcap", "-o", "out/merged", "-q"),
    ("replay", "--again", "run", "-o", "out/again", "-q"),
    ("replay", "log.mcap", "-o", "out/more", *CONTINUED, "--continue", "run"),
    ("replay", "log.mcap", "-o", "out/there", *CONTINUED, "--map", "run"),
    ("view", "run", "-o", "out/view.html", "--no-browser"),
)
"""What reads a run directory."""

KINDS = (
    Kind("config", "c.yaml", (("config", "show", "c.yaml"),)),
    Kind("scenario", "s.yaml", (("simulate", "s.yaml", "-o", "out/run", "-q", "--set", "max_steps=2"),)),
    Kind("manifest", "m.yaml", (("batch", "m.yaml", "-o", "out/batch", "-q"),)),
    Kind(
        "baseline",
        "b.json",
        (("batch", "empty.mcap", "-o", "out/batch", "-q", "--baseline", "b.json", "--gate", "baseline"),),
    ),
    *(
        Kind(f"run/{name}", f"run/{name}", RUN_COMMANDS)
        for name in ("run.json", "trajectory.tum", "hits.npz", "result.mcap", "map.yaml", "walls.csv")
    ),
    Kind("batch.json", "done/batch.json", (("check", "done"),)),
    Kind("table", "t.tum", (("metrics", "run", "--truth", "t.tum"),)),
    Kind("log", "log.mcap", (("info", "log.mcap"), ("convert", "log.mcap", "out/x.mcap", "-q"))),
    Kind("map.yaml", "map.yaml", (("metrics", "map.yaml"),)),
    Kind("picture", "map.pgm", (("metrics", "map.yaml"), ("diff", "map.yaml", "sound", "-q")), attack_picture),
    Kind("run/map.pgm", "run/map.pgm", RUN_COMMANDS, attack_picture),
)


def make_home(folder: Path) -> None:
    """Write a valid file of every kind, including a real run."""
    assert cli.run(["replay", str(SAMPLE), "-o", str(folder / "run"), *SHORT]) == 0
    shutil.copytree(folder / "run", folder / "sound")
    shutil.copy(folder / "run" / "trajectory.tum", folder / "t.tum")
    for name in ("map.yaml", "map.pgm"):
        shutil.copy(folder / "run" / name, folder / name)
    (folder / "empty.mcap").write_bytes(b"")
    shutil.copy(SAMPLE, folder / "log.mcap")
    (folder / "c.yaml").write_text("method: robust\ngrid: 5x5\nrobust: {cell_mm: 25, near_mm: 100}\n")
    shutil.copy(ROOT / "configs" / "corner.yaml", folder / "s.yaml")
    manifest = {
        "logs": ["empty.mcap", {"log": "gone/*.mcap", "start_s": 0.5, "truth": "t.tum", "gates": ["scans.total>=1"]}],
        "runs": [{"name": "a", "grid": "5x5"}, {"config": "c.yaml"}],
        "gates": ["map.accepted_share>=0.5"], "accept": [3], "tolerances": {"map.accepted_share": "5%"}, "jobs": 1,
        "timeout_s": 20,
    }  # fmt: skip
    (folder / "m.yaml").write_text(yaml.safe_dump(manifest))
    cells = [{"name": "empty.mcap 20/10x10", "exit_code": 4, "figures": {"map.accepted_share": 0.5}}]
    baseline = {"schema_version": 1, "mavnav_version": "1", "cells": cells}
    (folder / "b.json").write_text(json.dumps(baseline))
    (folder / "done").mkdir()
    row = {"name": "a", "exit_code": 4, "directory": None, "error": "x", "accepted": False}
    (folder / "done" / "batch.json").write_text(json.dumps({"cells": [row, {**row, "directory": "../run"}]}))
    os.mkfifo(folder / "pipe")


RAW = "@raw@"
DEEP = (100, 5000, 200_000)


def hostile_value(rng: Random) -> tuple[Any, str]:
    """Return a hostile value, and the text that replaces `RAW` in the file."""
    depth = int(rng.choice(DEEP))
    values: list[tuple[Any, str]] = [
        (RAW, "9" * int(rng.choice([400, 5000, 400_000]))),
        (RAW, str(rng.choice(["1e300", "-1e308", "1e999", ".nan", ".inf", "-.inf", "NaN", "Infinity", "-Infinity"]))),
        (RAW, str(rng.choice(["0", "-1", "1e-300", "2147483648", "-9223372036854775809", "0x10", "0o7", "1_0", "~"]))),
        (RAW, "[" * depth + "]" * depth),
        (RAW, '{"a":' * depth + "1" + "}" * depth),
        (RAW, "&a [x,x]\nb: &b [*a,*a,*a]\nc: [*b,*b,*b]"),
        (RAW, "!!python/object/apply:os.system ['touch out_of_bounds']"),
        ("x" * int(rng.choice([300, 900_000, 3_000_000])), ""),
        (str(rng.choice(["pipe", "/dev/zero", "/dev/stdin", "/proc/self/mem", "..", "/", ""])), ""),
        (str(rng.choice(["\0", "a\n::error::b"])), ""),
        (str(rng.choice(["file:///dev/zero", "http://127.0.0.1:9/x", "memory://x", "../../../etc/passwd", "~"])), ""),
        (str(rng.choice(["\x1b[2J", "\u202e", "\ud800", "%s%n{0}", "**/*", "[", "run", "pipe::file://x"])), ""),
        ([[]], ""), ({}, ""), (None, ""), (True, ""), (-0.0, ""), ([0] * 100_000, ""),
        ({f"k{k}": k for k in range(int(rng.choice([10, 20_000])))}, ""),
    ]  # fmt: skip
    return values[int(rng.integers(len(values)))]


def paths(tree: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths of all values in a document, as tuples of keys."""
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [path, *(deeper for key, value in inner for deeper in paths(value, (*path, key)))]


def replaced(tree: Any, path: tuple[Any, ...], value: Any) -> Any:
    """Return a document with the value at a path replaced."""
    if not path:
        return value
    copy = dict(tree) if isinstance(tree, dict) else list(tree)
    copy[path[0]] = replaced(copy[path[0]], path[1:], value)
    return copy


def attack_document(rng: Random, content: bytes) -> bytes:
    """Replace one or two values of a JSON or YAML document."""
    tree = yaml.safe_load(content)
    text = ""
    for _ in range(int(rng.integers(1, 3))):
        value, text = hostile_value(rng)
        found = paths(tree)
        tree = replaced(tree, found[int(rng.integers(len(found)))], value)
    return json.dumps(tree).replace(f'"{RAW}"', text or "0").encode()


def attack_table(rng: Random, content: bytes) -> bytes:
    """Replace words of a table."""
    words = content.split(b" ")
    for _ in range(int(rng.integers(1, 4))):
        value, text = hostile_value(rng)
        words[int(rng.integers(len(words)))] = (text or str(value)).encode("utf-8", "backslashreplace")
    return b" ".join(words)


def attack(kind: Kind, rng: Random, folder: Path) -> None:
    """Attack the file of a kind in a copy of the folder with valid files."""
    path = folder / kind.file
    content = path.read_bytes()
    choice = float(rng.random())
    if kind.picture and choice < 0.7:
        kind.picture(rng, path)
    elif path.suffix in {".json", ".yaml"} and choice < 0.65:
        path.write_bytes(attack_document(rng, content))
    elif path.suffix == ".tum" and choice < 0.5:
        path.write_bytes(attack_table(rng, content))
    elif choice > 0.95:
        path.unlink()
        replacements = (os.mkfifo, os.mkdir, lambda name: name.symlink_to("/dev/zero"))
        replacements[int(rng.integers(3))](path)
    else:
        path.write_bytes(mutated(content, int(rng.integers(2**31))))
    if (
        kind.file.startswith("run/")
        and kind.name != "run/run.json"
        and path.is_file()
        and not path.is_symlink()
        and rng.random() < 0.7
    ):
        with_new_digest(path)


def _head(path):
    with path.open("rb") as file:
        return file.read(1 << 24)


def with_new_digest(path: Path) -> None:
    """Write the digest of an altered file to the run.json beside it, as an attacker would: its content is read."""
    document = json.loads((path.parent / "run.json").read_text())
    document["outputs"][path.name] = sha256(_head(path)).hexdigest()
    (path.parent / "run.json").write_text(json.dumps(document))


def main() -> int:
    """Print a line per kind, and every problem; return 1 if there are problems."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000, help="inputs in all")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after this time")
    parser.add_argument("--kinds", nargs="*", default=[])
    parser.add_argument("-v", "--verbose", action="store_true", help="print every end")
    options = parser.parse_args()
    os.environ |= {"MAVNAV_FETCH_TIMEOUT_S": "2", "MAVNAV_FETCH_MAX_MB": "10"}
    kinds = [kind for kind in KINDS if not options.kinds or kind.name in options.kinds]
    began_s, counts, total = time.monotonic(), {kind.name: Counter[str]() for kind in kinds}, Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        home = Path(name) / "home"
        home.mkdir()
        make_home(home)
        for number in range(options.count):
            if time.monotonic() - began_s > options.seconds:
                break
            kind = kinds[number % len(kinds)]
            rng = np.random.default_rng((options.seed, number))
            case = Path(name) / "case"
            shutil.copytree(home, case, ignore=shutil.ignore_patterns("pipe", "*.png"))
            os.mkfifo(case / "pipe")
            attack(kind, rng, case)
            args = kind.commands[int(rng.integers(len(kind.commands)))]
            end, found = problems(args, case)
            counts[kind.name] += Counter(["inputs", *(text.partition(":")[0] for text in found)])
            if found or options.verbose:
                print(f"  {kind.name} {number}: {found} {end.code} {end.cpu_s:.1f} s {end.err[-300:]}", flush=True)
            shutil.rmtree(case)
    for kind in kinds:
        total += counts[kind.name]
        print(table_row(kind.name, counts[kind.name]))
    print(table_row("all", total), f"in {time.monotonic() - began_s:.0f} s")
    return int(any(total[name] for name in COUNTED))


if __name__ == "__main__":
    sys.exit(main())
