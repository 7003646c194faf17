"""Output of a batch for CI: JUnit XML, a summary in Markdown, and annotations for GitHub.

The format of the XML, a test suite per log, a test case per run, is junit-10.xsd, the schema of Jenkins' xUnit plugin:
``testsuites`` of ``testsuite`` of ``testcase``, each case with at most one ``failure`` or ``error``. A failed gate, a
lost track and a damaged log are failures; a run without a result is an error. Metrics are the output of a case, because
the schema has properties for suites only.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final
from xml.etree import ElementTree as XML  # noqa: N814  short, because many lines use it

from mavnav.batch.document import KEY_FIGURES, absent_runs, batch_headline, change_text, missing_lines, why, worst_first
from mavnav.batch.files import FIGURES
from mavnav.outputs.documents.quantities import number, verdict_texts
from mavnav.outputs.report.markdown import escape, table_row

MAX_ROWS: Final = 100
"""Maximum number of runs in a summary, which GitHub limits to 1 MiB per step; the worst runs are shown."""

_INVALID_XML: Final = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 does not allow (section 2.2)."""


def to_junit(document: Mapping[str, Any]) -> str:
    """Return a batch as JUnit XML."""
    logs: dict[str, list[Mapping[str, Any]]] = {}
    for row in document["cells"]:
        logs.setdefault(row["log"], []).append(row)
    suites = [_suite(log, rows) for log, rows in logs.items()]
    if missing := absent_runs(document):
        suites.append(_missing(missing, failed=bool(document["baseline"].get("gate"))))
    sums = {name: str(sum(int(suite.attrib[name]) for suite in suites)) for name in ("tests", "failures", "errors")}
    seconds = sum(float(suite.attrib["time"]) for suite in suites)
    root = XML.Element("testsuites", {"name": "mavnav batch", **sums, "time": f"{seconds:.3f}"})
    root.extend(suites)
    XML.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + XML.tostring(root, encoding="unicode") + "\n"


def _totals(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    kinds = Counter(_kind(row) for row in rows)
    counts = {"tests": len(rows), "failures": kinds["failure"], "errors": kinds["error"]}
    return {**{name: str(count) for name, count in counts.items()}, "time": f"{sum(map(_seconds, rows)):.3f}"}


def _seconds(row: Mapping[str, Any]) -> float:
    """Return the duration of a run in s, in this batch or, if it was finished before, in its own run."""
    return float(row["seconds"] or number(row["run"], "timing.wall_s") or 0.0)


def _kind(row: Mapping[str, Any]) -> str | None:
    return None if not row["code"] else "failure" if row["run"] else "error"


def _suite(log: str, rows: Sequence[Mapping[str, Any]]) -> XML.Element:
    suite = XML.Element("testsuite", {"name": _text(log), **_totals(rows), "skipped": "0"})
    suite.extend(_case(log, row) for row in rows)
    return suite


def _case(log: str, row: Mapping[str, Any]) -> XML.Element:
    name = row["name"].removeprefix(log).strip() or row["name"]
    case = XML.Element("testcase", {"name": _text(name), "classname": _text(log), "time": f"{_seconds(row):.3f}"})
    kind, reasons = _kind(row), [_text(reason) for reason in why(row)]
    if kind:
        about = {"message": reasons[0], "type": f"exit code {row['code']}"}
        XML.SubElement(case, kind, about).text = "\n".join(reasons)
    figures = ((name, number(row["run"], name)) for name in FIGURES)
    old = (row["baseline"] or {}).get("before", {})
    before = {name: f" baseline {value:.6g}" for name, value in old.items() if value is not None}
    if known := [f"{name} {value:.6g}{before.get(name, '')}" for name, value in figures if value is not None]:
        word, reason = verdict_texts(row["run"])
        XML.SubElement(case, "system-out").text = _text("\n".join([f"verdict {word}: {reason}", *known]))
    return case


def _missing(names: Sequence[str], *, failed: bool) -> XML.Element:
    """Return a suite of the runs that are in the baseline and not in the batch."""
    count = str(len(names) if failed else 0)
    counts = {"tests": str(len(names)), "failures": count, "errors": "0", "time": "0.000"}
    suite = XML.Element("testsuite", {"name": "missing", **counts, "skipped": str(0 if failed else len(names))})
    for name in names:
        case = XML.SubElement(suite, "testcase", {"name": _text(name), "classname": "missing", "time": "0.000"})
        XML.SubElement(case, "failure" if failed else "skipped", {"message": "the baseline has it, this batch has not"})
    return suite


def _text(text: str) -> str:
    return _INVALID_XML.sub("?", text)


def to_summary(document: Mapping[str, Any]) -> str:
    """Return a batch in GitHub's Markdown: the headline, the failures, and a table, worst runs first."""
    rows = worst_first(document["cells"])
    mark = "✅" if document["exit_code"] == 0 else "❌"
    lines = [f"## {mark} mavnav batch", "", batch_headline(document) + ".", ""]
    bad = [row for row in rows if row["code"]]
    lines += [f"- **{escape(row['name'])}**: {escape('; '.join(why(row)))}" for row in bad[:MAX_ROWS]]
    lines += [f"- **{escape(name)}**: in the baseline, not in this batch" for name in absent_runs(document)[:MAX_ROWS]]
    lines += [""] if bad or absent_runs(document) else []
    titles = ["", "run", "verdict", *(figure.head for figure in KEY_FIGURES)]
    titles += ["since the baseline"] if document["baseline"] else []
    lines += [table_row(titles), table_row(["---"] * len(titles))]
    lines += [table_row(_cells(row, since=bool(document["baseline"]))) for row in rows[:MAX_ROWS]]
    if len(rows) > MAX_ROWS:
        lines += ["", f"{len(rows) - MAX_ROWS} more are in batch.html and batch.csv."]
    return "\n".join(lines) + "\n"


def _cells(row: Mapping[str, Any], *, since: bool) -> list[str]:
    mark = "❌" if row["code"] else "✅"
    word, numbers = verdict_texts(row["run"])[0] or "-", [figure.text_of(row["run"]) for figure in KEY_FIGURES]
    texts = [mark, escape(row["name"]), word, *numbers]
    return [*texts, change_text(row)] if since else texts


def github_commands(document: Mapping[str, Any]) -> list[str]:
    """Return the workflow commands that show the failures of a batch on GitHub, one line each."""
    bad = [row for row in worst_first(document["cells"]) if row["code"]]
    places = [f"file={_property(row['log'])},title={_property(row['name'])}" for row in bad]
    errors = [f"::error {place}::{_data('; '.join(why(row)))}" for place, row in zip(places, bad, strict=True)]
    return errors + [f"::{kind} title=mavnav::{_data(text)}" for kind, text in missing_lines(document)]


def _data(text: str) -> str:
    """Escape the text of a workflow command, which must be one line without a literal percent sign."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
