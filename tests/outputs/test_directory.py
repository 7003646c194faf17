"""The run directory appears complete or not at all."""

import errno
import hashlib
import json
import os
from functools import partial
from pathlib import Path

import pytest
from msgspec.structs import replace

from mavnav.errors import ExitCode, OutputError, UsageError
from mavnav.jobs.run_cache import check_cache_directory
from mavnav.outputs import writers
from mavnav.outputs.directory import atomic_directory, check_directory
from mavnav.outputs.files import document as documents
from mavnav.outputs.writers import write_run

ALWAYS = {
    "trajectory.tum", "trajectory.csv", "map.pgm", "map.yaml", "hits.npz", "map.png", "wall_thickness.png",
    "result.mcap", "foxglove_layout.json", "metrics.json", "run.json", "walls.csv",
}  # fmt: skip


@pytest.fixture
def light(monkeypatch):
    """Leave the pictures out: failures are about the directory."""
    few = {name: writers.WRITERS[name] for name in ("trajectory.tum", "map.yaml")}
    monkeypatch.setattr(writers, "WRITERS", few)


def break_writer(monkeypatch, error):
    def fail(run, path):
        path.write_text("half")
        raise error

    monkeypatch.setitem(writers.WRITERS, "map.yaml", fail)


@pytest.fixture(scope="module")
def twice(run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("twice")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "peak_memory_mb", lambda: 100.0)  # the process may still grow between the two
        return [(folder / name, write_run(run, folder / name)) for name in ("a", "b")]


def test_all_files_are_written(twice, run, change, tmp_path, light):
    assert {p.name for p in twice[0][0].iterdir()} == ALWAYS | {"trajectory_base.tum"}


def test_without_a_mounting_there_is_no_base(run, change, tmp_path):
    document = write_run(change(run, base_T_laser=None, mounting_source=None, base_frame=None), tmp_path / "x")
    assert {p.name for p in (tmp_path / "x").iterdir()} == ALWAYS
    assert set(document["outputs"]) == ALWAYS - {"run.json"}


def test_twice_the_same_bytes(twice):
    (a, _), (b, _) = twice
    for path in a.iterdir():
        assert path.read_bytes() == (b / path.name).read_bytes(), path.name


def test_the_document_is_run_json_and_tells_the_digest_of_every_file(twice):
    folder, document = twice[0]
    assert json.loads((folder / "run.json").read_text()) == document
    for name, digest in document["outputs"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    assert set(document["outputs"]) == {p.name for p in folder.iterdir()} - {"run.json"}


def test_what_exists_stays_without_force(run, tmp_path, light):
    write_run(run, tmp_path / "x")
    before = (tmp_path / "x" / "run.json").stat().st_mtime_ns
    with pytest.raises(OutputError, match="--force") as caught:
        write_run(run, tmp_path / "x")
    assert caught.value.exit_code == ExitCode.OUTPUT
    assert (tmp_path / "x" / "run.json").stat().st_mtime_ns == before


def test_force_replaces_a_run_with_all_that_is_in_it(run, tmp_path, light):
    write_run(run, tmp_path / "x")
    (tmp_path / "x" / "left.over").touch()
    write_run(run, tmp_path / "x", force=True)
    assert {p.name for p in (tmp_path / "x").iterdir()} == {"run.json", "trajectory.tum", "map.yaml"}
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


def test_force_fills_an_empty_directory(run, tmp_path, light):
    (tmp_path / "x").mkdir()
    write_run(run, tmp_path / "x", force=True)
    assert (tmp_path / "x" / "run.json").is_file()


@pytest.mark.parametrize("force", [False, True])
def test_a_directory_that_is_no_run_is_never_replaced(run, tmp_path, light, force):
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match="other files"):
        write_run(run, tmp_path / "x", force=force)
    assert (tmp_path / "x" / "thesis.tex").read_text() == "precious"


@pytest.mark.parametrize("force", [False, True])
def test_a_file_in_the_way_stays(run, tmp_path, light, force):
    (tmp_path / "x").write_text("precious")
    with pytest.raises(OutputError, match="is a file"):
        write_run(run, tmp_path / "x", force=force)
    with pytest.raises(OutputError, match="is a file"):
        check_cache_directory(tmp_path / "x", ["batch.json"])
    with pytest.raises(OutputError, match="no directory"):
        write_run(run, tmp_path / "x" / "y", force=force)
    assert (tmp_path / "x").read_text() == "precious"


@pytest.mark.parametrize("target", ["gone", "x"], ids=["dangling", "loop"])
@pytest.mark.parametrize("force", [False, True])
def test_a_link_to_nothing_is_told(tmp_path, target, force):
    link = tmp_path / "x"
    link.symlink_to(target)
    for check in (partial(check_directory, force=force), lambda path: check_cache_directory(path, ["batch.json"])):
        with pytest.raises(OutputError, match="x is a link that leads nowhere; remove it, or choose another"):
            check(link)
    link.unlink()
    check_directory(link, force=force)


def test_parents_are_made(run, tmp_path, light):
    write_run(run, tmp_path / "a" / "b" / "x")
    assert (tmp_path / "a" / "b" / "x" / "run.json").is_file()


def test_a_link_to_a_run_is_followed(run, tmp_path, light):
    write_run(run, tmp_path / "x")
    (tmp_path / "link").symlink_to("x")
    write_run(run, tmp_path / "link", force=True)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "x" / "run.json").is_file()


def test_an_unwritable_parent_is_an_output_error(run, light):
    with pytest.raises(OutputError, match="cannot be"):
        write_run(run, Path("/proc/mavnav/x"))


def test_a_parent_without_permission_is_told_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # permissions do not bind root
    with pytest.raises(OutputError, match="not writable"):
        check_directory(tmp_path / "x", force=False)


@pytest.mark.parametrize(
    ("error", "raised", "text"),
    [
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), OutputError, "No space left"),
        (RuntimeError("bug"), RuntimeError, "bug"),
        (KeyboardInterrupt("ctrl-c"), KeyboardInterrupt, "ctrl-c"),
    ],
)
@pytest.mark.parametrize("existing", [False, True])
def test_a_failing_writer_leaves_what_was_there(run, tmp_path, monkeypatch, light, existing, error, raised, text):
    if existing:
        write_run(run, tmp_path / "x")
    before = sorted(p.name for p in tmp_path.rglob("*"))
    break_writer(monkeypatch, error)
    with pytest.raises(raised, match=text):
        write_run(run, tmp_path / "x", force=True)
    assert sorted(p.name for p in tmp_path.rglob("*")) == before


def test_the_old_run_comes_back_where_the_new_cannot_take_its_place(run, tmp_path, monkeypatch, light):
    write_run(run, tmp_path / "x")
    rename = type(tmp_path).rename

    def refuse(self, target):
        if ".partial-" in str(self):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return rename(self, target)

    monkeypatch.setattr(type(tmp_path), "rename", refuse)
    monkeypatch.setattr("mavnav.atomic_files._swap_names", lambda one, other: False)
    with pytest.raises(OutputError, match="Permission denied"):
        write_run(run, tmp_path / "x", force=True)
    assert [p.name for p in tmp_path.iterdir()] == ["x"]
    assert (tmp_path / "x" / "run.json").is_file()


@pytest.fixture
def earlier(tmp_path, monkeypatch):
    """Be in a folder with an earlier run, a log in it and one outside of it."""
    monkeypatch.chdir(tmp_path)
    Path("r/bag").mkdir(parents=True)
    for name in ("r/run.json", "r/bag/metadata.yaml", "r/log.mcap", "log.mcap"):
        Path(name).touch()
    Path("inward").symlink_to("r/log.mcap")
    Path("r/outward").symlink_to("../log.mcap")
    Path("link").symlink_to("r")


@pytest.mark.usefixtures("earlier")
@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("directory", ["r", "link", "../{}/r"])
@pytest.mark.parametrize("name", ["r", "r/log.mcap", "r/bag", "link/bag/metadata.yaml", "inward", "r/outward"])
def test_a_run_with_an_input_in_it_is_not_replaced(tmp_path, directory, name, force):
    target = Path(directory.format(tmp_path.name))
    with pytest.raises(UsageError, match=f"^{name} is an input, and would be lost .* choose another directory with -o"):
        check_directory(target, force=force, inputs=(None, Path("log.mcap"), Path(name)))


@pytest.mark.usefixtures("earlier")
@pytest.mark.parametrize("name", ["log.mcap", ".", "r2", "r/gone.mcap", "../r"])
def test_inputs_beside_and_above_a_run_do_not_matter(name):
    Path("r2").mkdir()
    check_directory(Path("r"), force=True, inputs=(Path(name),))


@pytest.mark.usefixtures("earlier")
def test_a_parent_folder_that_is_read_is_not_in_the_run(monkeypatch):
    monkeypatch.chdir("r")
    check_directory(Path(), force=True, inputs=(Path(".."),))


@pytest.mark.parametrize("groups", [None, ("trajectory",)])
def test_warnings_name_the_picture_only_if_it_is_written(run, tmp_path, groups):
    odd = replace(run, slam=replace(run.slam, warnings=("it is odd; see map.png",)))
    document = write_run(odd, tmp_path / "x", groups=groups)
    ending = " of a run with --outputs pictures" if groups else ""
    assert f"it is odd; see map.png{ending}" in document["warnings"]
    assert f"map.png{ending}" in document["verdict"]["advice"]


def test_a_directory_that_cannot_be_examined_any_more_is_an_error_of_the_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: Path) -> None:
        raise OSError(errno.EIO, "Input/output error")

    (tmp_path / "run").mkdir()
    monkeypatch.setattr(Path, "iterdir", fail)
    with (
        pytest.raises(
            OutputError, match="run cannot be written: Input/output error; make room or choose another with -o"
        ),
        atomic_directory(tmp_path / "run", force=True),
    ):
        pass
