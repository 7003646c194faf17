"""Run directories of strangers: sizes, types and digests are checked by every command that reads them."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

import mavnav as api
from support.strange_runs import change_document, on_purpose, with_new_digests, write_counts

ALTERED = "has been altered since it was written"


@pytest.fixture(scope="module")
def original(tmp_path_factory, repo_root: Path) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "corridor"
    api.replay(repo_root / "sample_logs" / "corridor.mcap", directory=folder, end_s=2, report=False)
    return folder


@pytest.fixture
def run(original, tmp_path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "run"))


def readers(run: Path, sample: Path, folder: Path) -> list[tuple]:
    """Return the commands that read the files of a run."""
    other = ("replay", sample, "-o", folder / "other", "--end", "2", "-q")
    return [
        ("metrics", run, "-q"),
        ("check", run),
        ("diff", run, run, "-q"),
        ("merge", run, sample, "-o", folder / "merged", "-q"),
        (*other, "--continue", run),
        (*other, "--map", run),
    ]


READ_BY = {
    "hits.npz": ("metrics", "check", "diff"),
    "trajectory.tum": ("metrics", "check", "merge", "--continue"),
    "result.mcap": ("metrics", "check", "merge", "--continue"),
    "map.yaml": ("check", "--map"),
    "map.pgm": ("check", "--map"),
    "walls.csv": ("check",),
}


@pytest.mark.parametrize("name", READ_BY)
def test_every_reader_notices_an_altered_file(mavnav, run, sample, tmp_path, name) -> None:
    with (run / name).open("ab") as file:
        file.write(b"\n")
    for args in readers(run, sample, tmp_path):
        if set(args) & set(READ_BY[name]):
            code, out, err = mavnav(*args)
            assert (code, out, err.count("\n")) == (2, "", 1), args
            assert f"{name} {ALTERED}" in err
            assert "delete its line under 'outputs' of run.json" in err
    on_purpose(run, name)
    assert mavnav("check", run)[0] == 0


def test_a_file_edited_on_purpose_is_read_as_it_is(mavnav, run, original) -> None:
    lines = (run / "trajectory.tum").read_text().splitlines()
    (run / "trajectory.tum").write_text("\n".join(lines[:-3]) + "\n")
    with pytest.raises(api.UsageError, match=ALTERED):
        _ = api.load_run(run).trajectory
    on_purpose(run, "trajectory.tum")
    assert len(api.load_run(run).trajectory) == len(api.load_run(original).trajectory) - 3
    assert mavnav("metrics", run, "-q")[0] == 0


@pytest.mark.parametrize("side", [4000, 4200])
def test_counts_of_more_cells_than_a_file_of_its_size_can_hold_are_refused(mavnav, run, side) -> None:
    """The 125 KB that took `diff` 25 s and 2.7 GB: too many hits; and too many cells."""
    nines = np.broadcast_to(np.uint8(9), (side, side)).astype(np.uint8 if side > 4000 else np.int32)
    write_counts(run, nines, nines)
    del nines
    for args in (("metrics", run, "-q"), ("diff", run, run, "-q")):
        code, out, err = mavnav(*args)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "than a file of" in err


def test_other_packings_are_not_unpacked(mavnav, run) -> None:
    """A thousandfold of zlib is bounded by the size of the file; bzip2 and xz pack a million times as small."""
    blank = np.zeros((100, 100), np.int32)
    write_counts(run, blank, blank, zipfile.ZIP_BZIP2)
    code, _, err = mavnav("diff", run, run, "-q")
    assert (code, err.count("\n")) == (2, 1)
    assert "hits.npz is packed as numpy packs none" in err


@pytest.mark.parametrize("dtype", ["u1", "i1", "<u2", ">i4", "u8"])
def test_counts_of_any_integer_type_are_read(mavnav, run, dtype) -> None:
    with np.load(run / "hits.npz") as known:
        counts, passes = (np.minimum(known[name], 100) for name in ("counts", "passes"))
    write_counts(run, counts.astype(dtype), passes.astype(dtype))
    assert np.array_equal(api.load_run(run).map.hits, counts)
    assert mavnav("metrics", run, "-q")[0] == 0


@pytest.mark.parametrize("far_m", ["9e7", "3000"])
def test_poses_that_jump_are_refused(mavnav, run, sample, tmp_path, far_m) -> None:
    rows = [line.split() for line in (run / "trajectory.tum").read_text().splitlines() if line[0] != "#"]
    jumping = [[row[0], far_m if k % 2 else row[1], *row[2:]] for k, row in enumerate(rows)]
    (run / "trajectory.tum").write_text("".join(" ".join(row) + "\n" for row in jumping))
    with_new_digests(run)
    for args in readers(run, sample, tmp_path):
        if set(args) & {"metrics", "merge", "--continue"}:
            code, out, err = mavnav(*args)
            assert (code, out, err.count("\n")) == (2, "", 1), args
            assert "the poses of trajectory.tum jump" in err


@pytest.mark.parametrize(
    ("section", "value"),
    [
        ("input", [1]), ("tracking", []), ("scans", {"accepted": "many", "processed": 1}), ("outputs", {"../a": "b"}),
        ("config", {"truth_at": "noon"}), ("tracking", {"lost": False, "holds_s": 1e300}), ("exit_code", "0"),
    ],
    ids=str,
)  # fmt: skip
def test_a_section_of_another_type_is_refused(mavnav, run, sample, tmp_path, section, value) -> None:
    change_document(run, lambda document: document.update({section: value}))
    for args in readers(run, sample, tmp_path):
        if set(args) & {"metrics", "merge", "--continue"}:
            code, out, err = mavnav(*args)
            assert (code, out, err.count("\n")) == (2, "", 1), args
            assert "run.json lacks what is needed" in err


def test_a_document_that_is_cut_off_is_named(mavnav, run, sample, tmp_path) -> None:
    (run / "run.json").write_bytes((run / "run.json").read_bytes()[:700])
    for args in [*readers(run, sample, tmp_path), ("check", run), ("view", run), ("replay", "--again", run)]:
        code, _, err = mavnav(*args)
        assert (code, "run.json is no JSON, or cut off; " in err) == (2, True), (args, err)


def test_a_file_that_is_a_pipe_or_mostly_holes_is_not_read(mavnav, run) -> None:
    (run / "result.mcap").unlink()
    os.mkfifo(run / "result.mcap")
    assert "it has no result.mcap" in mavnav("metrics", run, "-q")[2]
    (run / "result.mcap").unlink()
    with (run / "result.mcap").open("wb") as file:
        file.truncate(1 << 40)
    assert "result.mcap is mostly holes" in mavnav("metrics", run, "-q")[2]


@pytest.mark.parametrize("name", ["walls.csv", "trajectory.csv"])
def test_a_table_that_never_ends_is_not_read(mavnav, run, tmp_path, name) -> None:
    """Of a run that names no digest of it."""
    change_document(run, lambda document: document["outputs"].pop(name))
    (run / name).unlink()
    (run / name).symlink_to("/dev/zero")
    code, _, err = mavnav("view", run, "--no-browser", "-o", tmp_path / "view.html", "-q")
    assert (code, f"it has no {name}" in err, (tmp_path / "view.html").exists()) == (2, True, False)


def test_a_run_without_its_other_files_is_checked(mavnav, run) -> None:
    for path in run.iterdir():
        if path.name != "run.json":
            path.unlink()
    assert mavnav("check", run)[0] == 0


def test_a_merge_without_its_sessions_is_not_measured(mavnav, run) -> None:
    document = {"sessions": [{"name": "a", "joined": True}], "outputs": {}, "config": {}, "mavnav_version": "1"}
    (run / "merge.json").write_text(json.dumps(document))
    assert "is no whole run: it has no session_a.tum" in mavnav("metrics", run, "-q")[2]
