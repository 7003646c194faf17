"""What to write here for what people type by the names of other tools (hints.toml), where a command line is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import typer


def hint(error: typer.TyperException) -> str:
    """Say what to write instead of an option or command that there is not; empty where that is not known.

    An option is named only where the command has it.
    """
    from tomllib import loads

    answers = loads(Path(__file__).with_name("hints.toml").read_text("utf-8"))
    context = getattr(error, "ctx", None)
    if option := getattr(error, "option_name", None):
        known = {name for each in context.command.params for name in each.opts} if context else set[str]()
        usable = {answer: names for answer, names in answers["options"].items() if answer.split()[0] in known}
        word = option.partition("=")[0].replace("_", "-")
        return _answer(answers["always"], word) or _written(_answer(usable, word))
    _, command, name = error.format_message().partition("No such command ")
    word = name.split("'")[1] if name.count("'") > 1 else ""
    if command and ("/" in word or "." in word):
        return _written(f"'mavnav replay {word}'")
    return _written(_answer(answers["commands"], word))


def _written(answer: str) -> str:
    return answer and f"write {answer}"


def _answer(answers: dict[str, str], word: str) -> str:
    return next((answer for answer, names in answers.items() if word in names.split()), "")
