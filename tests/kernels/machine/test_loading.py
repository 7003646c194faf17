"""Kernels come from the disk without the compiler, and are compiled again when what they are made of has changed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from hashlib import sha256
from shutil import copytree
from typing import TYPE_CHECKING, Any

import llvmlite.binding as llvm
import numpy as np
import pytest

from mavnav.kernels.machine.cache import VERSIONS_KEPT, cache_key
from mavnav.kernels.scans.points import extent, place_points

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture(autouse=True, scope="module")
def compiled() -> None:
    """Have the kernels on disk that these tests load."""
    assert extent(np.ones((3, 2))) == (1.0, 1.0, 1.0, 1.0)


def test_machine_code_is_loaded_without_numba() -> None:
    code = (
        "import sys, numpy as np\nfrom mavnav.kernels.scans.points import extent\n"
        "assert not extent.loaded\nextent(np.ones((3, 2)))\n"
        "assert extent.loaded and not extent.compiled and 'numba' not in sys.modules\n"
        "import numba\nassert numba.njit(lambda x: x + 1)(1) == 2"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.slow
def test_kernels_are_loaded_while_another_thread_imports_numba() -> None:
    code = (
        "import sys, time, threading, numpy as np\n"
        "from mavnav.kernels.scans.points import extent, place_points\n"
        "thread = threading.Thread(target=lambda: __import__('numba'))\nthread.start()\n"
        "while 'numba' not in sys.modules: time.sleep(0.001)\n"
        "assert extent(np.ones((3, 2))) == (1.0, 1.0, 1.0, 1.0)\n"
        "thread.join()\nassert not extent.compiled\n"
        "assert sys.modules['numba'].njit(lambda x: x + 1)(1) == 2"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    "wrong",
    [np.ones((3, 2), np.float32), np.ones(6), np.ones((3, 4))[:, ::2], [[1.0, 1.0]], np.ones((3, 2)).astype(">f8")],
    ids=["kind", "dimensions", "order", "list", "byte order"],
)
def test_arguments_of_other_types_are_refused(wrong: Any) -> None:
    with pytest.raises(TypeError, match="extent takes other arguments"):
        extent(wrong)


def test_arrays_that_a_kernel_writes_must_be_writable() -> None:
    out = np.ones((3, 2))
    out.flags.writeable = False
    with pytest.raises(TypeError, match="place_points takes other arguments"):
        place_points(np.ones((3, 2)), np.zeros(3), out)


def test_kernels_are_plain_functions_where_nothing_is_compiled() -> None:
    code = (
        "import numpy as np\nfrom mavnav.kernels.scans.points import extent\n"
        "assert extent(np.ones((3, 2))) == (1.0, 1.0, 1.0, 1.0)\nassert not hasattr(extent, 'loaded')"
    )
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


JIT = "from mavnav.kernels.machine.jit import helper, kernel\n"
SOURCES = {
    "constants": "FACTOR = 2.0\n",
    "helping": JIT + "from trial.constants import FACTOR\n\n@helper\ndef scaled(x):\n    return FACTOR * x\n",
    "calling": JIT + "from trial.helping import scaled\n\n@kernel\ndef f(x: float) -> float:\n    return scaled(x)\n",
    "apart": JIT + "\n@kernel\ndef g(x: float) -> float:\n    return x + 1.0\n",
}
CALL = (
    "from trial.apart import g\nfrom trial.calling import f\nprint(f(21.0), g(1.0), int(f.compiled), int(g.compiled))"
)


FORKING = """
import gc, os, sys
from numba.core.registry import cpu_target
cpu_target.target_context.refresh()
cpu_target.typing_context.refresh()
gc.freeze()
while line := sys.stdin.readline():
    folder, environment, code = eval(line)
    if not (child := os.fork()):
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        for number in (1, 2):
            os.dup2(os.open(f"stream {number}", os.O_CREAT | os.O_TRUNC | os.O_WRONLY), number)
        exec(code, {})
        break
    print(os.waitpid(child, 0)[1], flush=True)
"""
"""Has numba loaded, which takes a second or two, and forks a process for each code that is to run."""

Called = Callable[..., list[float]]


def environment_of(trial: Path) -> dict[str, str]:
    return os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "MAVNAV_CACHE_DIR": str(trial.parent / "cache")}


@pytest.fixture(scope="module")
def called() -> Iterator[Called]:
    """Run both kernels in a process of its own, after other statements.

    Returns their results, and how often each was compiled.
    """
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    with subprocess.Popen([sys.executable, "-c", FORKING], env=environment, **pipes) as forking:

        def call(trial: Path, before: str = "") -> list[float]:
            print((str(trial.parent), environment_of(trial), before + CALL), file=forking.stdin, flush=True)
            status = forking.stdout.readline()
            out, err = ((trial.parent / f"stream {number}").read_text() for number in (1, 2))
            assert (status, err) == ("0\n", "")
            return [float(word) for word in out.split()]

        yield call
        forking.stdin.close()


@pytest.fixture
def trial(tmp_path: Path) -> Path:
    """Return the folder of a package of two kernels, of which one calls a helper of another file."""
    return written(tmp_path / "trial")


def written(folder: Path) -> Path:
    folder.mkdir()
    for name, source in SOURCES.items():
        (folder / f"{name}.py").write_text(source)
    return folder


@pytest.fixture(scope="module")
def compiled_cache(tmp_path_factory: pytest.TempPathFactory, called: Called) -> Path:
    """Return a cache that holds both kernels."""
    folder = written(tmp_path_factory.mktemp("compiled") / "trial")
    assert called(folder) == [42.0, 2.0, 1, 1]
    return folder.parent / "cache"


@pytest.fixture
def compiled_trial(trial: Path, compiled_cache: Path) -> Path:
    """Return the folder of the package, with its kernels in the cache."""
    copytree(compiled_cache, trial.parent / "cache")
    return trial


@pytest.mark.parametrize(
    ("edited", "old", "new"), [("helping", "FACTOR * x", "100.0 * FACTOR * x"), ("constants", "2.0", "200.0")]
)
def test_a_kernel_is_compiled_again_where_a_file_that_it_imports_was_edited(
    compiled_trial: Path, edited: str, old: str, new: str, called: Called
) -> None:
    assert called(compiled_trial) == [42.0, 2.0, 0, 0]
    path = compiled_trial / f"{edited}.py"
    path.write_text(path.read_text().replace(old, new))
    assert called(compiled_trial) == [4200.0, 2.0, 1, 0]
    assert called(compiled_trial) == [4200.0, 2.0, 0, 0]


def entries(trial: Path) -> list[Path]:
    """Return the files of the trial's cache."""
    return sorted((trial.parent / "cache").glob("*/trial.*"))


MOVED = {
    "packing": "from numba.core import compiler\ndel compiler.CompileResult._reduce\n",
    "loading": "from mavnav.kernels.machine import loader\nloader._extension = None\n"
    "from numba.core import compiler\ndel compiler.CompileResult._rebuild\n",
    "runtime": "from mavnav.kernels.machine import loader\nloader._extension = None\n",
    "libraries": "import numba.core.codegen as c\ndel c.JITCodeLibrary\n",
}
"""What numba might look like in another version."""


@pytest.mark.parametrize("moved", MOVED)
def test_a_numba_without_these_parts_still_works(compiled_trial: Path, moved: str, called: Called) -> None:
    path = compiled_trial / "helping.py"
    path.write_text(path.read_text().replace("FACTOR * x", "FACTOR * x + 1.0"))
    assert called(compiled_trial, MOVED[moved])[:2] == [43.0, 2.0]
    assert not list(compiled_trial.parent.glob("cache/*/.*"))


NOT_LINKED = "from mavnav.kernels.machine import loader\nloader._address = None\n"
"""What it looks like on a system on which a C function that machine code calls is not known."""


def test_code_that_cannot_be_linked_is_loaded_by_numba(trial: Path, called: Called) -> None:
    assert called(trial, NOT_LINKED) == [42.0, 2.0, 1, 1]
    command = [sys.executable, "-c", NOT_LINKED + CALL + "\nimport sys\nprint('numba' in sys.modules)"]
    done = subprocess.run(
        command, cwd=trial.parent, env=environment_of(trial), capture_output=True, text=True, check=True
    )
    assert (done.stdout.splitlines(), done.stderr) == (["42.0 2.0 0 0", "True"], "")


def test_code_that_can_no_longer_be_linked_is_compiled_again(compiled_trial: Path, called: Called) -> None:
    assert called(compiled_trial, NOT_LINKED) == [42.0, 2.0, 1, 1]
    assert called(compiled_trial, NOT_LINKED) == [42.0, 2.0, 0, 0]
    assert called(compiled_trial) == [42.0, 2.0, 0, 0]


@pytest.mark.parametrize("damage", [lambda code: code[: len(code) // 2], lambda _: b"", lambda code: code[:-1] + b"x"])
def test_a_damaged_entry_is_made_anew(compiled_trial: Path, damage: Callable[[bytes], bytes], called: Called) -> None:
    path = entries(compiled_trial)[-1]
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    assert sum(called(compiled_trial)[2:]) == 1
    assert called(compiled_trial)[2:] == [0, 0]


def test_an_entry_that_numba_cannot_read_is_made_anew(compiled_trial: Path, called: Called) -> None:
    code = b"not what numba wrote"
    for path in entries(compiled_trial):
        path.write_bytes(sha256(code).digest() + code)
    assert called(compiled_trial) == [42.0, 2.0, 1, 1]
    assert called(compiled_trial) == [42.0, 2.0, 0, 0]


def test_what_cannot_be_written_goes_to_a_private_directory(
    trial: Path, monkeypatch: pytest.MonkeyPatch, called: Called
) -> None:
    """It ends with the process that made it."""
    (trial.parent / "cache").write_text("a file where the directory should be")
    temporary = trial.parent / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    look = "import os, tempfile\nfrom mavnav.kernels.machine import cache\ncache.write_code('name-1', b'code')\n"
    look += "assert cache.read_code('name-1') == b'code'\n(made,) = os.scandir(tempfile.gettempdir())\n"
    assert called(trial, look + "assert made.stat().st_mode & 0o777 == 0o700\n") == [42.0, 2.0, 1, 1]
    assert list(temporary.iterdir()) == []


def test_a_cache_that_can_only_be_read_serves(compiled_trial: Path, called: Called) -> None:
    (folder,) = (compiled_trial.parent / "cache").iterdir()
    folder.chmod(0o555)
    try:
        assert called(compiled_trial) == [42.0, 2.0, 0, 0]
    finally:
        folder.chmod(0o755)


def test_old_versions_of_a_kernel_are_removed(compiled_trial: Path, called: Called) -> None:
    (first,) = (entry for entry in entries(compiled_trial) if "calling" in entry.name)
    kernel = first.name.rpartition("-")[0]
    for age in range(1, VERSIONS_KEPT + 1):
        older = first.with_name(f"{kernel}-{age:024x}")
        older.write_bytes(first.read_bytes())
        os.utime(older, (1e9 - age, 1e9 - age))
    (compiled_trial / "constants.py").write_text("FACTOR = 3.0\n")
    assert called(compiled_trial) == [63.0, 2.0, 1, 0]
    kept = {entry.name for entry in entries(compiled_trial) if "calling" in entry.name}
    assert len(kept) == VERSIONS_KEPT
    assert first.name in kept
    assert kept > {f"{kernel}-{age:024x}" for age in range(1, VERSIONS_KEPT - 1)}


BUILD = (
    "import trial.apart, trial.calling\nfrom mavnav.kernels.machine.jit import KERNELS\n"
    "from mavnav.kernels.machine.building import prepare\nprepare(lambda *told: print(told[0]))\n"
    "print(all(made.code for made in KERNELS), *(int(made.loaded) for made in KERNELS))\n"
)


def built(trial: Path) -> subprocess.Popen[str]:
    environment = os.environ | {"MAVNAV_CACHE_DIR": str(trial.parent / "cache")}
    return subprocess.Popen(
        [sys.executable, "-c", BUILD], cwd=trial.parent, env=environment, stdout=subprocess.PIPE, text=True
    )


@pytest.mark.slow
def test_kernels_compile_in_other_processes_and_say_so_once(trial: Path) -> None:
    told = [f"compiling kernels (first run only): {done} of 2" for done in range(3)]
    assert built(trial).communicate(timeout=120)[0].splitlines() == [*told, "True 0 0"]
    assert built(trial).communicate(timeout=120)[0].splitlines() == ["True 0 0"]


@pytest.mark.slow
def test_two_processes_may_fill_an_empty_cache(trial: Path, called: Called) -> None:
    both = [built(trial) for _ in range(2)]
    assert [process.communicate(timeout=120)[0].splitlines()[-1] for process in both] == ["True 0 0"] * 2
    assert called(trial) == [42.0, 2.0, 0, 0]


@pytest.mark.slow
def test_kernels_that_are_not_used_are_left_out(tmp_path: Path) -> None:
    code = (
        "from mavnav.kernels.maps import free_cells\nfrom mavnav.kernels.scans import points\n"
        "from mavnav.kernels.machine.building import prepare\n"
        "prepare(lambda *_: None, {'scans.points'})"
    )
    environment = os.environ | {"MAVNAV_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    (entry,) = tmp_path.glob("*/*")
    assert entry.name.startswith("mavnav.kernels.maps.free_cells.free_positions-")


@pytest.mark.parametrize("variable", ["NUMBA_CPU_NAME", "NUMBA_BOUNDSCHECK"])
def test_machine_code_of_other_settings_has_another_key(variable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    key = cache_key.__wrapped__()
    assert key == cache_key.__wrapped__()
    monkeypatch.setenv(variable, os.environ.get(variable, "") + "1")
    assert cache_key.__wrapped__() != key


def test_machine_code_for_another_processor_has_another_key(monkeypatch: pytest.MonkeyPatch) -> None:
    key = cache_key.__wrapped__()
    monkeypatch.setattr(llvm, "get_host_cpu_name", lambda: "another")
    assert cache_key.__wrapped__() != key


STORM = """
import signal
import numpy as np
from mavnav.kernels.planning.potential import clearance

class Stop(Exception):
    pass

def stop(*_):
    raise Stop

def call_until_stopped():
    while True:
        clearance(walls, points)

walls, points = np.ones((4, 2)), np.ones((3, 2))
clearance(walls, points)
signal.signal(signal.SIGALRM, stop)
for _ in range(2000):
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.0002)
        call_until_stopped()
    except Stop:
        pass
"""


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers here")
def test_a_signal_handler_that_raises_never_ends_the_process() -> None:
    subprocess.run([sys.executable, "-c", STORM], check=True, capture_output=True)


FIRST = """
import signal
import numpy as np
from mavnav.kernels.planning.potential import clearance

class Stop(Exception):
    pass

def stop(*_):
    raise Stop

clearance.load()
signal.signal(signal.SIGALRM, stop)
try:
    signal.setitimer(signal.ITIMER_REAL, 0.05)
    clearance(np.ones((4000, 2)), np.ones((100000, 2)))
except Stop:
    print("stopped")
"""


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers here")
def test_a_signal_in_the_first_call_of_a_kernel_never_ends_the_process() -> None:
    ended = subprocess.run([sys.executable, "-c", FIRST], check=True, capture_output=True, text=True)
    assert ended.stdout == "stopped\n"
