"""Options that several commands share, with what they do; help shows each set in a panel of its own.

Parameters
----------
log
    MCAP, ROS 1 bag, ROS 2 bag folder, .db3 or CARMEN log.
logs
    MCAP, ROS 1 bag, ROS 2 bag folder, .db3 or CARMEN log; the parts of one, or their folder; an address, or -.
again
    Repeat the run in this directory, with its options.
methods
    SLAM method (default robust); repeatable.
azimuths
    Yaw samples: one number for all grids, or one for each (default twice N, at most 40).
config
    Configuration: a YAML file, or the name of a preset (default that of the method).
sets
    Override one configuration value; repeatable.
outputs
    Write only these files: trajectory, map, metrics, slices, pictures, mcap, report (default: these); svg,
    scale, graph; all.
report
    Write report.html also with --outputs.
report_page
    Also write the result as one page.
force
    Overwrite the output if it exists.
json
    Print one JSON document on stdout and nothing else.
quiet
    Show no progress.
jobs
    Parallel runs (default one a core).
preview
    Print the map as text, on stderr with --json (default on a terminal).
verbose
    Print every metric and warning.
gates
    Exit with code 1 unless this holds of run.json, e.g. 'tracking.lost==false'; repeatable.
accept
    Worst verdict that passes: good, suspect, wrong or lost (default suspect); or an exit code that counts as
    done. Repeatable.
trajectories
    FILE[,FRAME] (TUM, CSV, EuRoC, or a run), topic:/T or tf:MAP,FRAME; @first, @middle or @last: beam at whose
    time a pose holds (default: that of the scan as recorded). Repeatable.
programs
    Run a program that reads the log, {log}, and writes a trajectory, {out}. Repeatable.
program_s
    Longest time of a program.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import suppress
from functools import partial
from inspect import Parameter
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_args

import typer

from mavnav.commands import completion
from mavnav.commands.terminal import can_print, note, printable
from mavnav.config.option_kinds import CHECKS, INPUT, OUTPUT, RESOURCES, SEARCH, SWITCH
from mavnav.config.options import OPTIONS, fields_of_outputs
from mavnav.errors import ExitCode, UsageError, missing, worst

if TYPE_CHECKING:
    from mavnav.metrics.gates import Gate
    from mavnav.pipelines.again import EarlierRun

Command = TypeVar("Command", bound="Callable[..., None]")

input_option, search_option, output_option, check_option, resource_option = (
    partial(typer.Option, show_default=False, rich_help_panel=panel)
    for panel in (INPUT, SEARCH, OUTPUT, CHECKS, RESOURCES)
)
"""An option of a panel without a default of its own."""

LATEST = "latest"
"""The link to the last result that the user gave no name, beside that."""

_LAST = ("config", "sets", "list_", "schema")
_OF_A_RUN = ("again", "directory", "force", "report", "outputs", "preview", "verbose", "json", "quiet", "gates")
"""Parameters of every run, also of one that repeats another."""

directory_option = partial(output_option, "--output", "-o", metavar="DIR")
schema_option = partial(input_option, "--schema")
"""Options whose help differs between commands."""


def replay_option(name: str, **changes: str) -> Any:  # noqa: ANN401  as typer.Option
    """Return an option of a replay for typer, with ``changes`` of its usage, help or completer."""
    option = OPTIONS[name]._replace(**changes)  # type: ignore[arg-type]
    words = [word for word in (option.metavar or "").split("|") if word.isalpha() and word.islower()]
    completer = getattr(completion, option.completer) if option.completer else completion.words(*words)
    return typer.Option(
        option.flag,
        metavar=option.metavar,
        help=option.help,
        show_default=False,
        rich_help_panel=option.panel,
        autocompletion=completer if words or option.completer else None,
    )


def with_options(*names: str, **changes: dict[str, str]) -> Callable[[Command], Command]:
    """Give options of a replay to a command, which takes them as ``**given``; typer reads the signature.

    ``changes`` are those of `replay_option` by the name of the option. In its panel of the help, an option follows
    those of the command, but for the general ones in `_LAST`.
    """
    shared = [_parameter(name, changes.get(name, {})) for name in names]

    def command(function: Command) -> Command:
        signature = inspect.signature(function, eval_str=True)
        own = [each for each in signature.parameters.values() if each.kind is not Parameter.VAR_KEYWORD]
        parameters = _in_panels(own, shared)
        function.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        function.__annotations__ = {each.name: each.annotation for each in parameters}
        return function

    return command


def _parameter(name: str, changes: dict[str, str]) -> Parameter:
    kind = OPTIONS[name].kind
    annotation: Any = Annotated[kind.typed, replay_option(name, **changes)]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=False if kind is SWITCH else None, annotation=annotation)


def _in_panels(own: list[Parameter], shared: list[Parameter]) -> list[Parameter]:
    """Return the arguments and then the options, panel by panel in the order of the help."""
    keywords = [each for each in own if each.kind is Parameter.KEYWORD_ONLY]
    panels = [_panel(each) for each in keywords]
    more = [panel for panel in map(_panel, shared) if panel not in panels]
    order = list(dict.fromkeys([INPUT, SEARCH, *more, *panels]))
    ranked = [(each, 2 if each.name in _LAST else 0) for each in keywords] + [(each, 1) for each in shared]
    ranked.sort(key=lambda pair: (order.index(_panel(pair[0])), pair[1]))
    return [*(each for each in own if each not in keywords), *(each for each, _ in ranked)]


def _panel(parameter: Parameter) -> str:
    return str(get_args(parameter.annotation)[1].rich_help_panel)


def _not_by_link(run: Path | None) -> Path | None:
    """Return a run by its own name: when it is repeated, ``latest`` leads to the repetition."""
    return run.parent / run.readlink() if run and run.is_symlink() else run


log_argument = partial(typer.Argument, metavar="LOG", show_default=False)
LogSource = Annotated[str, log_argument()]
LogParts = Annotated[list[str], log_argument()]
MaybeLogParts = Annotated[list[str] | None, log_argument()]
Again = Annotated[Path | None, input_option("--again", metavar="RUN", callback=_not_by_link)]
Methods = Annotated[list[str] | None, replay_option("method")]
Azimuths = Annotated[list[int] | None, replay_option("azimuth")]
ConfigFile = Annotated[str | None, search_option(metavar="FILE", autocompletion=completion.presets)]
Sets = Annotated[list[str] | None, search_option("--set", metavar="KEY=VALUE")]
Outputs = Annotated[str | None, output_option("--outputs", metavar="GROUP,...", autocompletion=completion.outputs)]
ReportFile = Annotated[Path | None, output_option("--report", metavar="FILE.html")]
Report = Annotated[bool, output_option("--report")]
Force = Annotated[bool, output_option("--force")]
Json = Annotated[bool, output_option("--json")]
Quiet = Annotated[bool, output_option("--quiet", "-q")]
Jobs = Annotated[int | None, resource_option("--jobs", "-j", min=1, metavar="N")]
Preview = Annotated[bool | None, output_option("--preview/--no-preview")]
Verbose = Annotated[bool, output_option("--verbose", "-v")]
Gates = Annotated[list[str] | None, check_option("--gate", metavar="'NAME<=X'")]
Accept = Annotated[
    list[str] | None, check_option("--accept", metavar="VERDICT|CODE", autocompletion=completion.verdicts)
]
Trajectories = Annotated[list[str] | None, input_option("--trajectory", metavar="[NAME=]SOURCE")]
Programs = Annotated[list[str] | None, input_option("--external", metavar="NAME=COMMAND")]
ProgramLimit = Annotated[float, resource_option("--time-limit", min=0.0, metavar="SECONDS")]


def output_values(outputs: str | None, *, report: bool, preview: bool | None) -> dict[str, Any]:
    """Return whether the page is written, and ``outputs`` as the names that ``--outputs`` lists; raises UsageError."""
    if outputs is None:
        return {"report": True}
    names = outputs.split(",")
    if preview and not {"map", "all"} & {*names}:
        raise UsageError("--preview is drawn from map; add it to --outputs")
    return fields_of_outputs(names, report=report)


def check_logs(logs: Sequence[Path]) -> None:
    """Raise UsageError for a log that is not there; what is named like a folder beside a log is where to write."""
    gone = [log for log in logs if not log.exists()]
    if gone:
        folder = len(gone) < len(logs) and not gone[0].suffix
        raise UsageError(missing(gone[0], f"to write there, use -o {gone[0]}" if folder else "name a log"))


def again_directory(again: Path) -> Path:
    """Return the default directory of a run that repeats another."""
    return Path("runs") / f"{again.resolve().name}-again"


def free_directory(context: typer.Context, usual: Path, *, force: bool) -> Path:
    """Return the first directory that is free, of ``usual``, ``usual-2`` and so on; with ``force`` the first of all.

    It is reserved until the command ends, so that another process takes the next one.
    """
    from mavnav.atomic_files import claim

    numbered = (usual.with_name(f"{usual.name}-{number}") for number in count(2))
    free = (path for path in chain([usual], numbered) if force or not os.path.lexists(path))
    return next(path for path in free if force or context.with_resource(claim(path)))


def link_latest(directory: Path) -> None:
    """Make ``latest`` beside a result that the user gave no name a link to it, unless something else has that name."""
    link, fresh = directory.with_name(LATEST), directory.with_name(f".{LATEST}-{os.getpid()}")
    if link.is_symlink() or not os.path.lexists(link):
        with suppress(OSError):
            fresh.symlink_to(directory.name)
            fresh.replace(link)


def without_latest(paths: Sequence[Path]) -> list[Path]:
    """Return paths, as of ``runs/*``, without the link ``latest`` to another of them."""
    others = {os.path.realpath(path) for path in paths if path.name != LATEST}
    return [path for path in paths if path.name != LATEST or os.path.realpath(path) not in others]


def run_to_repeat(
    context: typer.Context, again: Path, directory: Path | None, *free: str, simulated: bool
) -> EarlierRun:
    """Return the run that ``--again`` repeats, of a mission or a replay, and report what differs since.

    ``free`` are parameters, besides those of the output, that it does not take from there. Raises UsageError for what
    is no such run, for an option that it takes from there, and where the result would replace the run.
    """
    from mavnav.pipelines.again import earlier_run

    target = directory or again_directory(again)
    replaced, kept = Path(os.path.realpath(target)), Path(os.path.realpath(again))
    if kept.is_relative_to(replaced):
        what = "is" if kept == replaced else "contains"
        raise UsageError(f"{target} {what} the run to repeat; choose another directory with -o")
    for flag in typed_flags(context, (*_OF_A_RUN, *free)):
        raise UsageError(f"--again takes {flag} from the run; leave one of them out")
    run = earlier_run(again, simulated=simulated)
    for difference in run.differences():
        note(f"mavnav: warning: {difference}")
    return run


def typed_flags(context: typer.Context, allowed: Container[str | None]) -> Iterator[str]:
    """Yield the options on the command line, but for those of parameters that are ``allowed``."""
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if parameter.name not in allowed and source is not None and source.name == "COMMANDLINE":
            yield max(parameter.opts, key=len)


def note_repetition(again: Path, document: dict[str, Any]) -> None:
    """Print whether a repetition has the files of the run that it repeats."""
    from mavnav.config.named_files import read_json
    from mavnav.outputs.directory import RUN_FILE
    from mavnav.pipelines.again import EarlierRun

    note(f"mavnav: {EarlierRun(again, read_json(again / RUN_FILE)).outcome(document)}")


def gates_of(texts: list[str] | None) -> list[Gate]:
    """Read the gates; raises UsageError, before the work."""
    if not texts:
        return []
    from mavnav.metrics.gates import parse_gate, renaming

    gates = [parse_gate(text) for text in texts]
    for old in filter(None, (renaming(gate.name) for gate in gates)):
        note(f"mavnav: {old}")
    return gates


def check_gates(gates: list[Gate], *sections: str) -> None:
    """Raise UsageError for a gate on a number that run.json will not have, before the work.

    ``sections`` are the optional sections of run.json that it will have.
    """
    if not gates:
        return
    from mavnav.metrics.gates import check_names
    from mavnav.outputs.documents.schema import number_names, run_keys

    more = [key for key in run_keys() if key.partition(".")[0] in sections]
    check_names((gate.name for gate in gates), [*number_names(reference="reference" in sections), *more])


def gated_code(document: dict[str, Any], gates: list[Gate]) -> ExitCode:
    """Return the exit code of a document and its gates, and report on stderr which of them do not hold.

    Raises UsageError for a name that is a number in other runs only: a run is written by then.
    """
    from mavnav.metrics.gates import judge

    failed = [row for row in judge(gates, document) if not row["passed"]]
    for row in failed:
        note(f"mavnav: error: gate {row['gate']} failed: {row['why']}")
    return worst([document["exit_code"], *(ExitCode.GATE_FAILED for _ in failed)])


def show_preview(directory: Path, title: str = "", lines: int = 24, *, stderr: bool = False) -> None:
    """Print the map of a run directory as so many lines of text at most, under a title if one is given."""
    from mavnav.outputs.files.gridmap import read_npz
    from mavnav.outputs.pictures.preview import preview

    stream = sys.stderr if stderr else sys.stdout
    drawn = preview(read_npz(directory / "hits.npz"), lines=lines, braille=can_print("\u28ff", stream))
    print(*["", *([printable(title)] if title else []), *drawn], sep="\n", file=stream, flush=True)
