"""The command line: the typer app, and ``main``, the only place that catches exceptions, prints them and exits."""

from __future__ import annotations

import errno
import os
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from io import TextIOWrapper
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Annotated, Final, NoReturn

import typer

from mavnav.commands import COMMANDS, signals
from mavnav.commands.terminal import emit, note, print_traceback
from mavnav.commands.values import CommandGroup, PlainCommand, describe
from mavnav.errors import ExitCode, MavnavError, UsageError, lacks_memory

LIBRARIES = ("numpy", "numba", "scipy", "mcap", "rosbags", "msgspec", "pillow", "typer")

_STREAM_ERRORS = (errno.ENOSPC, errno.EBADF, errno.EIO, errno.EFBIG, errno.EDQUOT)
"""Errors of a full or closed stream; errors of files have a file name."""

_PATH_ERRORS = {errno.ENAMETOOLONG: "choose a shorter name"} | dict.fromkeys(
    (errno.EACCES, errno.EPERM), "check its folders' permissions"
)
"""Errors of a path where even its existence cannot be checked -> what to do."""

EPILOG = """
[bold]Examples[/bold]
mavnav info drive.mcap
mavnav replay drive.mcap -o runs/drive
mavnav replay drive.bag --method paper --grid 20x20 --azimuth 40
mavnav compare drive.mcap --grid 5x5 --grid 10x10 --grid 20x20
mavnav batch logs/ -j 4 --gate 'map.accepted_share>=0.95'
mavnav simulate corner.yaml
[bold]Exit codes[/bold]  0 done; 1 the mission, a quality gate or the verdict (batch, check) failed, a session did \
not join (merge), the maps cannot be aligned (diff), or nothing could be estimated (calibrate); 2 usage or \
configuration; 3 done but the input was damaged; 4 no usable scans; 5 tracking was lost for good; 6 the output cannot \
be written; 70 a bug, or a run that died or exceeded a limit (batch); 130 interrupted; 143 terminated.
"""


def _print_version(wanted: bool) -> None:
    if not wanted:
        return
    import platform

    from mavnav.version import __version__, installed_version

    libraries = ", ".join(f"{name} {installed_version(name)}" for name in LIBRARIES)
    emit(f"mavnav {__version__} (Python {platform.python_version()}; {libraries})")
    raise typer.Exit


def _global_options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the versions and exit.")
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of an error; anywhere on the line, or MAVNAV_DEBUG=1.")
    ] = False,
) -> None:
    """Declare the global options; ``main`` has evaluated them already."""


def app_for(args: Sequence[str]) -> typer.Typer:
    """Return the app with the command in ``args``, or with all commands: loading the options of all takes 60 ms."""
    app = typer.Typer(
        name="mavnav",
        cls=CommandGroup,
        help="Map a recorded 2D laser log offline: trajectory, map and map quality, without ROS and without odometry.",
        epilog=_epilog(EPILOG, "index.md"),
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_global_options)
    wanted = next((arg for arg in args if not arg.startswith("-")), "")
    for name in (wanted,) if wanted in COMMANDS else COMMANDS:
        module = import_module(f"mavnav.commands.{name}")
        epilog = _epilog(_examples_of(module), COMMANDS[name])
        if name == "config":
            app.add_typer(module.app, name=name, epilog=epilog)
            for info in module.app.registered_commands:
                info.epilog, info.help = epilog, describe(info.callback)
        else:
            command = getattr(module, name)
            app.command(cls=PlainCommand, epilog=epilog, help=describe(command))(command)
    return app


def _examples_of(module: ModuleType) -> str:
    """Return what the docstring of a command's module says after its title."""
    return re.sub(r"^(\w+)\n-+$", r"[bold]\1[/bold]", (module.__doc__ or "").partition("\n")[2], flags=re.MULTILINE)


def _epilog(text: str, page: str) -> str:
    """Return the text after the options in a help page, each line a paragraph, with the documentation page."""
    lines = [*text.strip().split("\n"), f"[bold]Documentation[/bold]  mavnav docs {page.replace('.md', '')}"]
    if sys.flags.optimize > 1:  # it drops docstrings, which hold the help
        lines += ["Without descriptions, because of Python's -OO or PYTHONOPTIMIZE=2."]
    return "\n\n".join(lines)


SPARE_BYTES: Final = 4 << 20
"""Memory that is kept for the message on an error, which may be that there is none."""


def run(args: Sequence[str], *, debug: bool = False) -> int:
    """Run one command line and return its exit code; an error is printed on stderr in one line."""
    spare = bytearray(SPARE_BYTES)
    try:
        _check_words(args)
        code = app_for(args)(args=list(args), prog_name="mavnav", standalone_mode=False, obj=("mavnav", *args))
        sys.stdout.flush()
    except BaseException as error:
        spare.clear()
        if debug and isinstance(error, Exception):
            print_traceback(error)
        reason = None if isinstance(error, MavnavError) else signals.pending_stop()
        return _explain(reason() if reason else error)  # an import that is interrupted may raise something else
    return int(code or 0)


def _check_words(args: Sequence[str]) -> None:
    """Raise UsageError for an empty argument, which as a path is the current folder, and for ``-o=DIR``, ``=DIR``."""
    ended = args.index("--") if "--" in args else len(args)
    for number, (before, word) in enumerate(pairwise(["mavnav", *args])):
        place = word if re.fullmatch("--[a-z-]+=", word) else "" if word.strip() else f"what follows {before}"
        if place:
            advice = "give it a value, or leave it out"
            raise UsageError(f"{place} is empty, as of a shell variable that is not set; {advice}")
        if number < ended and re.match("-[a-z]=", word):
            raise UsageError(f"{word} has a sign of equality too many; write {word[:2]} {word[3:]}")


def _explain(error: BaseException) -> int:
    """Print an error on stderr, and return its exit code."""
    match error:
        case typer.TyperException():
            context = getattr(error, "ctx", None)
            command = context.command_path if context else "mavnav"
            text = error.format_message().replace("Value error, ", "").rstrip(".")
            hint = _hint(error)
            text = re.split(r" [(]Possible|[.] Did" if hint else " [(]Possible", text)[0]
            advice = hint or f"see '{command} --help'"
            note(f"mavnav: error: {text}; {advice}")
            return ExitCode.USAGE
        case MavnavError():
            note(f"mavnav: error: {error}")
            return error.exit_code
        case signals.Stopped():
            note(f"mavnav: {error.word}")
            return error.exit_code
        case BrokenPipeError() | SystemExit(__context__=BrokenPipeError()):  # typer's, if a reader ends, as in `| head`
            return ExitCode.OUTPUT
        case OSError(filename=None) if error.errno in _STREAM_ERRORS:
            note(f"mavnav: error: the result cannot be written to stdout: {error.strerror}; make room, or redirect it")
            return ExitCode.OUTPUT
        case SystemExit():  # shell completion
            return int(error.code or 0)
        case OSError(errno=int() as number) if error.filename is not None and number in _PATH_ERRORS:
            note(f"mavnav: error: {error.filename} cannot be reached: {error.strerror}; {_PATH_ERRORS[number]}")
            return ExitCode.USAGE
        case PermissionError(filename=None):  # of memory
            note(f"mavnav: error: {error.strerror}")
            return ExitCode.USAGE
        case _ if lacks_memory(error):
            note("mavnav: error: out of memory; try larger cells, narrower windows, or a part of the log with --end")
            return ExitCode.USAGE
        case _:
            bug = f"a bug: {type(error).__name__}: {error}; run again with --debug and report what it shows"
            note(f"mavnav: error: {bug}")
            return ExitCode.BUG


def _hint(error: typer.TyperException) -> str:
    """Say what to write instead of an option or command that there is not; empty where that is not known.

    An option is named only where the command has it.
    """
    from difflib import get_close_matches
    from tomllib import loads

    answers = loads((Path(__file__).parent / "commands" / "hints.toml").read_text("utf-8"))
    context = getattr(error, "ctx", None)
    if (option := getattr(error, "option_name", None)) and hasattr(error, "possibilities"):
        known = sorted({name for each in context.command.params for name in each.opts} if context else ())
        usable = {answer: names for answer, names in answers["options"].items() if answer.split()[0] in known}
        word = option.partition("=")[0].replace("_", "-")
        near = [name for name in known if word.startswith(f"{name}-")] or get_close_matches(word, known, cutoff=0.8)
        return _answer(answers["always"], word) or _written(_answer(usable, word) or next(iter(near), ""))
    _, command, name = error.format_message().partition("No such command ")
    word = name.split("'")[1] if name.count("'") > 1 else ""
    if command and ("/" in word or "." in word):
        return _written(f"'mavnav replay {word}'")
    return _written(_answer(answers["commands"], word))


def _written(answer: str) -> str:
    return answer and f"write {answer}"


def _answer(answers: dict[str, str], word: str) -> str:
    return next((answer for answer, names in answers.items() if word in names.split()), "")


def _split_debug(args: Sequence[str]) -> tuple[list[str], bool]:
    """Remove ``--debug`` from the arguments before any ``--``, so that it is also allowed after the command.

    Returns the remaining arguments, and whether ``--debug`` or MAVNAV_DEBUG is set.
    """
    end = args.index("--") if "--" in args else len(args)
    rest = [a for a in args[:end] if a != "--debug"] + list(args[end:])
    return rest, len(rest) < len(args) or os.environ.get("MAVNAV_DEBUG", "") not in ("", "0")


def _open_streams() -> None:
    """Replace streams that were closed before the start, as by ``>&-``, by the null device.

    Characters that the encoding of stdout lacks are escaped, as those of stderr are.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115  it stays open
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit with its code (docs/cli.md, "Exit codes")."""
    _open_streams()
    rest, debug = _split_debug(sys.argv[1:] if args is None else args)
    signals.listen()  # last, as `run` answers what it raises
    code = run(rest or ["--help"], debug=debug)
    signals.ignore()
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        # Otherwise the interpreter reports at shutdown that it cannot flush.
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = code or ExitCode.OUTPUT
    sys.exit(code)
