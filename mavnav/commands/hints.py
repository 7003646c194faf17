"""What people type by the names of other tools, and what to write here; asked only where a command line is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import typer

_OPTIONS: Final = {
    "--odom off": "--no-odom --no-odometry --without-odom --scan-only",
    "--odom TOPIC": "--odom-topic --odometry --odometry-topic",
    "--end SECONDS, counted from the first scan as --start is": "--duration --length --until --stop --max-time",
    "--start SECONDS": "--begin --skip --from --offset",
    "--resolution METERS": "--map-resolution --cell-size --cell --res --resolution-m --voxel-size",
    "--topic NAME": "--laser-topic --scan-topic --laser --scan --lidar --lidar-topic",
    "-o DIR": "--out --output-dir --outdir --out-dir --output-directory --output-folder --dir --directory --dest",
    "--force": "--overwrite --yes -f -y --replace",
    "--loop-closure off": "--no-loop-closure --no-loop --no-loops",
    "--deskew off": "--no-deskew",
    "--truth FILE.tum": "--ground-truth --groundtruth --gt --reference",
    "--map MAP": "--localize --localization --load-map",
    "--start-pose X,Y,YAW": "--initial-pose --init-pose --pose",
    "--set KEY=VALUE": "--param --params -p --override",
    "--config FILE": "--cfg --params-file --config-file --settings -c",
    "--jobs N": "--threads --workers --parallel --processes -n",
    "--set robust.far_mm=MM": "--max-range --range-max --max-laser-range",
    "--set robust.near_mm=MM": "--min-range --range-min",
}
"""What to write -> options of other tools."""

_ALWAYS: Final = {
    "leave it out; 'mavnav view RUN' shows the result": "--visualize --visualise --plot --show --gui --rviz "
    "--viz --display --view --interactive",
    "leave it out; a log is read as fast as it can be": "--rate --speed --realtime --clock --use-sim-time -r",
}
"""The same, for any command."""

_COMMANDS: Final = {
    "'mavnav replay LOG'": "run slam map mapping process build start launch",
    "'mavnav replay LOG', then 'mavnav view RUN', which plays the scans": "play playback animate",
    "'mavnav info LOG'": "bag rosbag inspect stat stats topics check-log describe ls",
    "'mavnav view RUN'": "plot show visualize visualise open gui display report",
    "'mavnav metrics RUN'": "evaluate eval evo ate ape measure quality validate",
    "'mavnav compare LOG --set KEY=A,B'": "sweep tune grid ablation",
    "'mavnav batch benchmark'": "benchmark bench",
    "'mavnav edit RUN'": "crop clean erase trim",
    "'mavnav merge RUN RUN'": "join stitch combine multi",
    "'mavnav replay LOG --map MAP'": "localize localise localization amcl",
    "'mavnav simulate SCENARIO'": "sim simulator fly",
    "'mavnav convert LOG OUT.mcap'": "export transform",
    "'mavnav --version'": "version",
    "'mavnav --help'": "help man usage",
}
"""What to write -> commands of other tools."""


def hint(error: typer.TyperException) -> str:
    """Say what to write instead of an option or command that there is not; empty where that is not known.

    An option is named only where the command has it.
    """
    context = getattr(error, "ctx", None)
    if option := getattr(error, "option_name", None):
        known = {name for each in context.command.params for name in each.opts} if context else set[str]()
        usable = {answer: names for answer, names in _OPTIONS.items() if answer.split()[0] in known}
        word = option.partition("=")[0].replace("_", "-")
        return _answer(_ALWAYS, word) or _written(_answer(usable, word))
    _, command, name = error.format_message().partition("No such command ")
    word = name.split("'")[1] if name.count("'") > 1 else ""
    if command and ("/" in word or "." in word):
        return _written(f"'mavnav replay {word}'")
    return _written(_answer(_COMMANDS, word))


def _written(answer: str) -> str:
    return answer and f"write {answer}"


def _answer(answers: dict[str, str], word: str) -> str:
    return next((answer for answer, names in answers.items() if word in names.split()), "")
