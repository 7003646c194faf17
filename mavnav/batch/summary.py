"""Output of a batch for CI: a summary in Markdown, and annotations for GitHub."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from mavnav.batch.baseline import ChangeKind, lacking_text
from mavnav.batch.document import why, worst_first
from mavnav.metrics.gates import VERDICTS
from mavnav.outputs.documents.quantities import NAMED, TIME, verdict_texts
from mavnav.outputs.report.markdown import escape, table_row

MAX_ROWS: Final = 100
"""Maximum number of runs in a summary, which GitHub limits to 1 MiB per step; the worst runs are shown."""

FIGURES: Final = (
    NAMED["map.accepted_share"],
    NAMED["wall_thickness.spread.p95_mm"],
    NAMED["map_quality.ghost_walls.length_m"],
    TIME,
)


def batch_headline(document: Mapping[str, Any]) -> str:
    """Return the result of a batch in one line."""
    rows = document["cells"]
    bad = sum(bool(row["code"]) for row in rows)
    counts, since = document["counts"], document["baseline"]
    parts = [f"{len(rows) - bad} of {len(rows)} runs passed"]
    parts += [f"{count} {word}" for word, count in counts["verdicts"].items() if word != VERDICTS[0]]
    parts += [f"{counts['failed']} could not be made"] if counts["failed"] else []
    parts += [f"{counts['cached']} reused"] if counts["cached"] else []
    if since:
        parts.append(f"since the baseline {since['worse']} worse, {since['better']} better, {since['new']} new")
        parts += [f"{len(since['missing'])} missing"] if since["missing"] else []
    return ", ".join(parts)


def to_summary(document: Mapping[str, Any]) -> str:
    """Return a batch in GitHub's Markdown: the headline, the failures, and a table, worst runs first."""
    rows = worst_first(document["cells"])
    mark = "✅" if document["exit_code"] == 0 else "❌"
    lines = [f"## {mark} mavnav batch", "", batch_headline(document) + ".", ""]
    bad = [row for row in rows if row["code"]]
    lines += [f"- **{escape(row['name'])}**: {escape('; '.join(why(row)))}" for row in bad[:MAX_ROWS]]
    lines += [f"- **{escape(name)}**: in the baseline, not in this batch" for name in _missing(document)[:MAX_ROWS]]
    lines += [""] if bad or _missing(document) else []
    titles = ["", "run", "verdict", *(figure.head for figure in FIGURES)]
    titles += ["since the baseline"] if document["baseline"] else []
    lines += [table_row(titles), table_row(["---"] * len(titles))]
    lines += [table_row(_cells(row, since=bool(document["baseline"]))) for row in rows[:MAX_ROWS]]
    if len(rows) > MAX_ROWS:
        lines += ["", f"{len(rows) - MAX_ROWS} more are in batch.html and batch.csv."]
    return "\n".join(lines) + "\n"


def missing_lines(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return severity and text for every missing run of the baseline; an error if the baseline is a gate.

    So too for every metric that the baseline file lacks, unless the baseline is a gate: its runs fail for that.
    """
    since = document["baseline"] or {}
    kind = "error" if since.get("gate") else "warning"
    lines = [(kind, f"{name}: in the baseline, not in this batch") for name in _missing(document)]
    absent = [] if since.get("gate") else since.get("lacking", [])
    return lines + [("warning", f"{lacking_text(since['path'], name)}; it is not compared") for name in absent]


def _missing(document: Mapping[str, Any]) -> list[str]:
    return list((document["baseline"] or {}).get("missing", []))


def _cells(row: Mapping[str, Any], *, since: bool) -> list[str]:
    mark = "❌" if row["code"] else "✅"
    texts = [mark, escape(row["name"]), verdict_texts(row["run"])[0] or "-", *(f.text_of(row["run"]) for f in FIGURES)]
    return [*texts, change_text(row)] if since else texts


def change_text(row: Mapping[str, Any]) -> str:
    """Return the change of a run since the baseline as text; empty without a baseline or a change."""
    change = row["baseline"]
    if not change or change["change"] == ChangeKind.SAME:
        return ""
    return f"{change['change']} {', '.join(item['name'] for item in change['figures'])}".strip()


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
