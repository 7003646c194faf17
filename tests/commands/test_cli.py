"""The roof: versions, help, streams, bugs, and the helpers that keep terminals safe."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import sleep

import pytest

from mavnav import __version__, cli
from mavnav.commands import progress, signals
from mavnav.commands.terminal import json_text, printable
from mavnav.errors import ExitCode, MavnavError, NoScansError, OutputError, TopicError
from mavnav.kernels.machine.jit import KERNELS


def test_version_names_the_libraries(mavnav: Callable) -> None:
    code, out, _ = mavnav("--version")
    assert code == 0
    assert out.startswith(f"mavnav {__version__} (Python ")
    assert out.count("\n") == 1
    assert all(f"{name} " in out for name in cli.LIBRARIES)


def test_warmup_leaves_no_kernel_out(mavnav: Callable) -> None:
    code, out, _ = mavnav("warmup")
    folder = Path(cli.__file__).parent / "kernels"
    files = [path.relative_to(folder).with_suffix("") for path in folder.rglob("*.py")]
    assert code == 0
    assert re.fullmatch(rf"compiled \d+ kernels in \d+\.\d s; {len(KERNELS)} are ready\n", out)
    assert {".".join(("mavnav.kernels", *path.parts)) for path in files} <= sys.modules.keys()


def test_warmup_refuses_to_compile_for_nothing(spawn: Callable, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.touch()
    process = spawn("warmup", MAVNAV_CACHE_DIR=str(taken / "kernels"))
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out) == (6, "")
    assert (
        err == f"mavnav: error: {taken / 'kernels'} cannot be written; set MAVNAV_CACHE_DIR to a directory that can\n"
    )


def test_without_arguments_it_shows_its_help(spawn: Callable) -> None:
    process = spawn()
    out, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (0, "")
    assert "replay" in out
    assert "Exit codes" in out


def test_help_has_examples(mavnav: Callable) -> None:
    for command in ("replay", "info"):
        code, out, _ = mavnav(command, "--help")
        assert code == 0
        assert "Examples" in out
        assert f"mavnav {command} drive.mcap" in out


def test_unknown_commands_are_one_line(mavnav: Callable) -> None:
    code, out, err = mavnav("repay")
    assert (code, out) == (ExitCode.USAGE, "")
    assert err.startswith("mavnav: error: No such command 'repay'")
    assert err.count("\n") == 1
    assert mavnav("config")[0] == ExitCode.USAGE


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("simulate corner --duration 5", "No such option: --duration; see 'mavnav simulate --help'"),
        ("info a.bag --odom-topic /odom", "No such option: --odom-topic; see 'mavnav info --help'"),
        ("replay a.bag --reslution 0.05", "No such option: --reslution; write --resolution"),
        ("replay a.bag --end_time 5", "No such option: --end_time; write --end"),
        ("replay a.bag -o", "Option '-o' requires an argument; see 'mavnav replay --help'"),
        ("config show --set", "Option '--set' requires an argument; see 'mavnav config show --help'"),
        ("replay a.bag --force=no", "Option '--force' does not take a value; see 'mavnav replay --help'"),
    ],
)
def test_an_option_is_suggested_where_it_is_near_else_the_help_of_the_command(
    mavnav: Callable, line: str, what: str
) -> None:
    assert mavnav(*line.split()) == (ExitCode.USAGE, "", f"mavnav: error: {what}\n")


@pytest.mark.parametrize(
    ("line", "place"),
    [
        (["replay", ""], "what follows replay"),
        (["batch", "logs", ""], "what follows logs"),
        (["merge", "", ""], "what follows merge"),
        (["replay", "a.bag", "-o", ""], "what follows -o"),
        (["replay", "a.bag", "--map="], "--map="),
        (["config", "show", " "], "what follows show"),
        (["info", "--", ""], "what follows --"),
        ([""], "what follows mavnav"),
    ],
)
def test_an_empty_argument_is_not_the_current_folder(
    mavnav: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: list[str], place: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.bag").touch()
    code, out, err = mavnav(*line)
    assert (code, out) == (ExitCode.USAGE, "")
    assert err.startswith(f"mavnav: error: {place} is empty, as of a shell variable that is not set; ")
    assert [path.name for path in tmp_path.iterdir()] == ["a.bag"]


def test_a_letter_takes_its_value_without_a_sign_of_equality(mavnav: Callable) -> None:
    said = "mavnav: error: -o=out has a sign of equality too many; write -o out\n"
    assert mavnav("replay", "gone.bag", "-o=out") == (ExitCode.USAGE, "", said)
    assert "-o=out: no such file" in mavnav("info", "--", "-o=out")[2]


def test_completion_answers(spawn: Callable) -> None:
    process = spawn(_MAVNAV_COMPLETE="complete_bash", COMP_WORDS="mavnav re", COMP_CWORD="1")
    out, _ = process.communicate(timeout=30)
    assert out.split() == ["replay"]


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (NoScansError("x"), ExitCode.NO_SCANS),
        (TopicError("x"), ExitCode.USAGE),
        (OutputError("x"), ExitCode.OUTPUT),
        (MavnavError("x"), ExitCode.BUG),
        (signals.Interrupted(), ExitCode.INTERRUPTED),
        (signals.Terminated(), ExitCode.TERMINATED),
        (ZeroDivisionError("x"), ExitCode.BUG),
        (BrokenPipeError(), ExitCode.OUTPUT),
        (PermissionError(13, "Permission denied", "folder/x"), ExitCode.USAGE),
        (MemoryError(), ExitCode.USAGE),
    ],
    ids=lambda value: type(value).__name__,
)
def test_every_end_has_its_code(
    mavnav: Callable, monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int
) -> None:
    def fail(*args: object, **kwargs: object) -> None:
        raise error

    monkeypatch.setattr("mavnav.config.loading.load_config", fail)
    got, out, err = mavnav("config", "show")
    assert (got, out) == (code, "")
    assert err.count("\n") == (0 if isinstance(error, BrokenPipeError) else 1)
    assert "Traceback" not in err
    if isinstance(error, ZeroDivisionError):
        assert "a bug: ZeroDivisionError: x; run again with --debug" in err
    else:
        assert "a bug" not in err


@pytest.mark.parametrize("line", ["info LOG", "replay LOG", "calibrate LOG", "convert LOG x.mcap", "merge LOG LOG"])
def test_a_log_without_permission_gives_one_message(
    mavnav: Callable, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, line: str
) -> None:
    """The root user may read every file, so the system's answers are replaced."""
    log = tmp_path / "a.bag"
    log.touch()

    def denied(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("os.access", lambda path, mode: not (str(path) == str(log) and mode & os.R_OK))
    monkeypatch.setattr("mavnav.logs.formats.detect.sniff", denied)
    code, out, err = mavnav(*line.replace("LOG", str(log)).split())
    assert (code, out) == (ExitCode.USAGE, "")
    assert err == f"mavnav: error: {log}: cannot be read (Permission denied); check the file and its permissions\n"


def test_what_the_encoding_of_stdout_lacks_is_escaped(tmp_path: Path) -> None:
    run = tmp_path / "caf\xe9"
    run.mkdir()
    (run / "run.json").write_text('{"exit_code": 0}')
    env = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-m", "mavnav", "check", run], capture_output=True, env=env, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.endswith(rb"caf\xe9: passed" + b"\n")


def test_debug_shows_the_traceback(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("mavnav.config.loading.load_config", lambda *_: 1 / 0)
    for args, env in (
        (["config", "show", "--debug"], ""),
        (["--debug", "config", "show"], ""),
        (["config", "show"], "1"),
    ):
        monkeypatch.setenv("MAVNAV_DEBUG", env)
        with pytest.raises(SystemExit) as caught:
            cli.main(args)
        assert caught.value.code == ExitCode.BUG
        assert "ZeroDivisionError: division by zero" in capsys.readouterr().err.splitlines()[-2]


def test_config_show_can_be_read_back(mavnav: Callable, tmp_path: Path) -> None:
    _, out, _ = mavnav("config", "show", "paper", "--set", "paper.cell_mm=13")
    file = tmp_path / "c.yaml"
    file.write_text(out)
    assert mavnav("config", "show", file)[1] == out
    assert "cell_mm: 13.0  # " in out


def test_config_schema_is_json(mavnav: Callable) -> None:
    schema = json.loads(mavnav("config", "schema")[1])
    assert schema["additionalProperties"] is False
    assert json.loads(mavnav("config", "schema", "config")[1]) == schema
    run_json = json.loads(mavnav("config", "schema", "run")[1])
    assert run_json["properties"]["map"]["properties"]["cell_mm"]["unit"] == "mm"
    code, _, err = mavnav("config", "schema", "walk")
    assert code == 2
    assert "is not one of 'config', 'run'" in err


def test_a_reader_that_leaves_is_no_traceback(tmp_path: Path) -> None:
    command = f"{sys.executable} -m mavnav config schema | head -c 5; echo ${{PIPESTATUS[0]}} >&2"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("{")
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr


def on_terminal(*args: str, **env: str) -> str:
    """Run with a terminal as stdout and stderr, and return all that came out."""
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "mavnav", *args],
        stdout=slave,
        stderr=slave,
        env=os.environ | {"TERM": "xterm-256color"} | env,
    )
    os.close(slave)
    chunks = []
    try:
        while chunk := os.read(master, 65536):
            chunks.append(chunk)
    except OSError:  # Linux's word for the end
        pass
    os.close(master)
    assert process.wait(timeout=60) == 0
    return b"".join(chunks).decode()


def test_no_color_is_respected(sample: Path) -> None:
    coloured = on_terminal("info", str(sample))
    assert "\x1b[1m" in coloured
    plain = on_terminal("info", str(sample), NO_COLOR="1")
    assert "\x1b[3" not in plain


@pytest.mark.parametrize(
    ("text", "safe"),
    [
        ("/scan [bold]", "/scan [bold]"),
        ("a\x1b[31mb", "a\\x1b[31mb"),
        ("a\nb\rc\x07", "a\\nb\\rc\\x07"),
        ("x\u202ey\u200bz\x9b", "x\\u202ey\\u200bz\\x9b"),
        ("\udcff", "\\udcff"),
        ("Büro 3", "Büro 3"),
        ("::error::x", "\\x3a:error::x"),
        ("  ::set-env::x", "  \\x3a:set-env::x"),
        ("zip://a::b", "zip://a::b"),
        ("a##[error]b ##vso[x]", "a#\\x23[error]b #\\x23vso[x]"),
    ],
)
def test_printable(text: str, safe: str) -> None:
    assert printable(text) == safe


def test_plain_lines_come_now_and_then(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    clock = iter(range(1000))
    monkeypatch.setattr(progress, "monotonic", lambda: next(clock))
    with progress.reporting(quiet=False) as report:
        for done in range(40):
            report("track", done, 40)
    lines = capsys.readouterr().err.splitlines()
    assert 3 < len(lines) < 20
    assert lines[0].startswith("mavnav: track ")
    assert lines[0].endswith(" s left")


def test_lines_have_the_number_of_the_stage_and_the_time_left_of_the_job(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(progress, "monotonic", lambda: now[0])
    with progress.reporting(quiet=False, stages={"read": 0, "track": 50, "write": 50}) as report:
        for phase in ("read", "track", "track again"):
            for done in (25, 50):
                now[0] += 6.0 if done == 25 else 12.0
                report(phase, done, 100)
    told = [line for line in capsys.readouterr().err.splitlines() if "%" in line]
    assert told[0] == "mavnav: read (1 of 3) 50 %"
    assert told[1] == "mavnav: track (2 of 3) 50 %, 36 s left"
    assert told[2].startswith("mavnav: track again (2 of 3) 50 %, ")


def test_no_stage_is_silent_for_long(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for name, value in (("LINE_PERIOD_S", 0.05), ("TICK_S", 0.01), ("ANNOUNCE_AFTER_S", 0.02)):
        monkeypatch.setattr(progress, name, value)
    with progress.reporting(quiet=False, stages=progress.REPLAY) as report:
        report("close loops", 0, 100)
        sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 2
    assert set(lines) <= {"mavnav: close loops (3 of 6)", "mavnav: close loops (3 of 6), for 0 s"}


def test_quiet_is_silent(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(progress, "LINE_PERIOD_S", 0.0)
    with progress.reporting(quiet=True) as report:
        report("track", 1, 2)
        report("track", 2, 2)
    assert capsys.readouterr().err == ""


def test_a_phase_of_unknown_length_is_named_if_it_lasts(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "ANNOUNCE_AFTER_S", 0.05)
    import time

    with progress.reporting(quiet=False) as report:
        report("loading", 0, None)
        time.sleep(0.3)
        report("writing", 0, None)
    assert capsys.readouterr().err == "mavnav: loading\n"


def test_a_signal_within_exec_leaves_the_exit_code_alone(tmp_path: Path) -> None:
    """A KeyboardInterrupt there would make Python end by SIGINT, whatever code it was told."""
    (tmp_path / "interrupted.py").write_text("""
import sys
from mavnav.commands import signals

signals.listen()
try:
    exec("import os, signal; os.kill(os.getpid(), signal.SIGINT)")
except signals.Interrupted as error:
    sys.exit(error.exit_code)
""")
    done = subprocess.run([sys.executable, "-m", "interrupted"], cwd=tmp_path, check=False, timeout=60)
    assert done.returncode == ExitCode.INTERRUPTED


def test_kernels_that_compile_are_interrupted_at_once() -> None:
    code = """
import os, signal
from mavnav.commands import progress

with progress.loading_modules():
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    finally:
        print("unwound")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (ExitCode.TERMINATED, "", "mavnav: terminated\n")


def test_a_signal_that_python_drops_in_a_finalizer_is_not_lost() -> None:
    """As happens to a Ctrl-C while kernels compile."""
    code = """
import os, signal, time
from mavnav.commands import progress, signals

class Dropping:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)

signals.listen()
with progress.reporting(quiet=True) as report:
    report("before", 0, None)
    Dropping()
    try:
        report("after", 0, None)
    except signals.Interrupted:
        print("obeyed")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "Exception ignored" in done.stderr
    assert done.stdout == "obeyed\n"


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux lists the threads of a process")
def test_the_command_line_begins_no_threads_of_linear_algebra() -> None:
    code = "import mavnav.__main__, numpy, os; print(len(os.listdir('/proc/self/task')))"
    env = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=env)
    assert done.stdout == "1\n"


def test_json_holds_no_workflow_command() -> None:
    text = json_text({"log": "##[error]x ##vso[y] # ##"})
    assert "##[" not in text
    assert json.loads(text) == {"log": "##[error]x ##vso[y] # ##"}


def test_names_of_logs_start_no_workflow_command(
    mavnav: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name = f"::error::{'x' * 190}::error::##[error]\x1b[31m.mcap"
    Path(name).touch()
    for args in (("batch", name, "-o", "out"), ("batch", name, "-o", "out", "--json"), ("info", name)):
        code, out, err = mavnav(*args)
        assert code == ExitCode.NO_SCANS
        for line in (out + err).splitlines():
            assert not line.lstrip().startswith("::")
            assert "##[" not in line
            assert "\x1b" not in line


@pytest.mark.parametrize(
    "args", [("info", "gone.mcap"), ("config", "show", "--set", "nonsense"), ("--debug", "info", "x")]
)
def test_a_full_stderr_keeps_the_exit_code(args: tuple[str, ...], repo_root: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([sys.executable, "-m", "mavnav", *args], stdout=subprocess.PIPE, stderr=full, check=False)
    assert (done.returncode, done.stdout) == (ExitCode.USAGE, b"")


def test_an_early_ctrl_c_leaves_no_traceback() -> None:
    """As soon as the first line of the package has run; before it, it is Python's own."""
    code = """
import os, runpy, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
runpy.run_module("mavnav", run_name="__main__")
"""
    for name in ("mavnav.cli", "typer", "mavnav.commands.signals"):
        line = [sys.executable, "-c", code, name]
        done = subprocess.run(line, capture_output=True, text=True, check=False)
        assert done.returncode in {-signal.SIGINT, ExitCode.INTERRUPTED}, name
        assert "Traceback" not in done.stderr


def test_off_a_terminal_there_is_a_line_in_a_period(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in (("TICK_S", 0.005), ("ANNOUNCE_AFTER_S", 0.01)):
        monkeypatch.setattr(progress, name, value)
    with progress.reporting(quiet=False) as report:
        for k in range(10):
            report(f"phase {k}", 0, None)
            sleep(0.05)
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_an_error_that_a_signal_caused_is_that_signal() -> None:
    """As where an import that is interrupted raises ImportError; it was a bug, exit code 70."""
    code = """
import os, signal
from mavnav import cli

def interrupted(args):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    except BaseException as error:
        raise ImportError("numpy") from error

cli.app_for = interrupted
cli.main(["info", "x"])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (ExitCode.TERMINATED, "mavnav: terminated\n")


def test_a_signal_before_the_command_runs_ends_silently() -> None:
    """One that came while the streams were opened was a traceback with exit code 1, "a gate failed"."""
    script = """
import mavnav.__main__, os, signal
from mavnav import cli
cli._open_streams = lambda: os.kill(os.getpid(), signal.SIGINT)
mavnav.__main__.main()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, b"")


@pytest.mark.skipif(sys.platform != "linux", reason="the C library of another system")
def test_a_library_that_ends_the_process_fails_no_gate() -> None:
    """OpenBLAS calls ``exit(1)`` where it gets no memory, and 1 is a gate that failed."""
    script = """
import ctypes, mavnav.__main__
from mavnav import cli
cli.main = lambda: ctypes.CDLL(None).exit(1)
mavnav.__main__.main()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (ExitCode.USAGE, b"")


@pytest.mark.skipif(sys.platform != "linux", reason="RLIMIT_AS is another elsewhere")
@pytest.mark.parametrize("limit_mb", [116, 118, 120, 250])
def test_without_memory_for_a_library_there_is_one_line(repo_root: Path, tmp_path: Path, limit_mb: int) -> None:
    """For OpenBLAS, llvmlite (which was a bug: exit code 70), and a message, for which 4 MB are kept."""
    import resource

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (limit_mb << 20, limit_mb << 20))

    line = [
        sys.executable,
        "-m",
        "mavnav",
        "replay",
        repo_root / "sample_logs" / "corridor.mcap",
        "-o",
        tmp_path / "run",
    ]
    done = subprocess.run(line, capture_output=True, text=True, check=False, preexec_fn=limit)
    assert (done.returncode, done.stderr.count("\n")) == (ExitCode.USAGE, 1)
    assert "emory" in done.stderr
