"""The headline of a report: which grid is best, by how much, and at which cost, as far as the metrics support it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from mavnav.metrics.gates import NO_MAP
from mavnav.outputs.documents import quantities
from mavnav.outputs.documents.quantities import Quantity, number
from mavnav.outputs.documents.verdict import EXTERNAL
from mavnav.outputs.report import tables
from mavnav.outputs.report.tables import NamedRun
from mavnav.units import pluralize

QUALITY: Final = tuple(q for q in quantities.QUANTITIES if not q.cost)
P95: Final = quantities.NAMED["wall_thickness.spread.p95_mm"]
TIME: Final = quantities.NAMED["timing.cpu_s"]
REVISITS: Final = quantities.NAMED["map_quality.revisits.nn_l_mm"]


def headline(entries: Sequence[NamedRun]) -> str:
    """Return the result of the runs of one log in one or two sentences."""
    if not entries:
        return "No run gave a map: each failed, for the reason below."
    if len(entries) == 1:
        return _mission(entries[0]) + _of_one(entries[0])
    sound = [e for e in entries if not quantities.why_not_meaningful(e.document)]
    if not sound:
        why = quantities.why_not_meaningful(entries[0].document)
        return f"None of the {len(entries)} maps is worth comparing; {entries[0].name}: {why}."
    if len(sound) == 1:
        only = f"Only {sound[0].name} gives a map worth looking at; the table says what is wrong with the others."
        return only + _suspects(sound)
    left_out = len(entries) - len(sound)
    runs = f"{pluralize(left_out, 'run')} {'is' if left_out == 1 else 'are'}"
    return _of_many(sound) + _suspects(sound) + (f" {runs} left out: the table says why." if left_out else "")


def _suspects(sound: Sequence[NamedRun]) -> str:
    """Return a sentence for every reason by which runs are suspect; empty if there are none."""
    by_reason: dict[str, list[str]] = {}
    for run in sound:
        word, reason = quantities.verdict_texts(run.document)
        if word == "suspect":
            by_reason.setdefault(reason, []).append(run.name)
    are = {reason: f"{_list(names)} {'is' if len(names) == 1 else 'are'}" for reason, names in by_reason.items()}
    return "".join(f" {names} suspect: {reason}." for reason, names in are.items())


def _mission(entry: NamedRun) -> str:
    """Return the sentence on a mission that failed; empty for others, and for replays."""
    mission = entry.document.get("mission")
    return f"The mission failed: {mission['reason']}. " if mission and not mission["reached"] else ""


def _of_one(run: NamedRun) -> str:
    """Return the sentences on a single run: its verdict, and what its map is like."""
    word, reason = quantities.verdict_texts(run.document)
    scans = run.document["scans"]
    verdict = f"{word.capitalize()}: {reason}. " if word else ""
    accepted = f"{verdict}{run.name} accepted {scans['accepted']} of {scans['processed']} scans"
    quality = run.document.get("map_quality") or {}
    p95_mm = P95.of(run.document)
    if "map" not in run.document:
        return f"{accepted}; {NO_MAP}."
    if not quality.get("meaningful", True) or word in quantities.UNUSABLE:
        return f"{accepted}; measures of the map say nothing."
    thin = f"95 % of the wall length is at most {tables.text(p95_mm, 0)} mm thick"
    return f"{accepted}; {'there is no straight wall to measure' if p95_mm is None else thin}{_ghosts(run)}."


def _ghosts(entry: NamedRun) -> str:
    count = number(entry.document, "map_quality.ghost_walls.count")
    many = f"{count} of its walls {'is' if count == 1 else 'are'}"
    return "" if count is None else f", and {many if count else 'no wall is'} drawn twice"


def _of_many(sound: Sequence[NamedRun]) -> str:
    """Return the sentences for several maps, of which those of one cell size are compared by more metrics."""
    groups = quantities.by_cell_mm(e.document for e in sound)
    if len(groups) < 2:
        return _ranking(sound, QUALITY, "measure here")
    everywhere = tuple(q for q in QUALITY if not q.per_cell)
    why = quantities.size_note(e.document for e in sound)
    alike = {cell_mm: [sound[k] for k in group] for cell_mm, group in groups.items() if len(group) > 1}
    within = (f"Cells of {mm:g} mm: {_ranking(runs, QUALITY, 'measure here')}" for mm, runs in alike.items())
    overall = _ranking(sound, everywhere, "measure that does not depend on the cell size")
    return " ".join((overall, f"{why[0].upper()}{why[1:]}.", *within))


def _ranking(sound: Sequence[NamedRun], quality: Sequence[Quantity], measure: str) -> str:
    """Return the sentence for several maps: the run that is best by most metrics, if there is one."""
    winners = {q: quantities.winners(q, [e.document for e in sound]) for q in quality}
    won = {q: best for q, best in winners.items() if best}
    if not won:
        names = _list([e.name for e in sound])
        alike = f"the maps of {names} are equally good by every {measure}{_within_noise(sound, quality)}"
        return f"{_finer(sound)}{alike}{_fewest_evaluations(sound)}."
    score = [sum(k in best for best in won.values()) for k in range(len(sound))]
    leaders = [k for k, wins in enumerate(score) if wins == max(score)]
    all_ = "the one measure that differs" if len(won) == 1 else f"all {len(won)} measures that differ"
    of = all_ if max(score) == len(won) else f"{max(score)} of the {len(won)} measures that differ"
    best = min((sound[k] for k in leaders), key=tables.fineness)
    measures = "; ".join(_differs(q, sound, best, won[q]) for q in won if leaders[0] in won[q])
    if len(leaders) > 1:
        equal = f"{_list([sound[k].name for k in leaders])} are each best by {of} ({measures})"
        prefix = _finer(sound, best) or "No run stands out: "
        return f"{prefix}{equal}{_fewest_evaluations(sound)}."
    text = f"{_finer(sound, best)}{best.name} gives the best map, best by {of} ({measures})"
    return f"{text}. {_cost(sound, best)}".rstrip()


def _differs(quantity: Quantity, sound: Sequence[NamedRun], best: NamedRun, won: Sequence[int]) -> str:
    """Return the best value of a measure and the next one, and by how much such values are uncertain."""
    values = [v for k, e in enumerate(sound) if k not in won and (v := quantity.of(e.document)) is not None]
    second = (min if quantity.better < 0 else max)(values)
    text = f"{quantity.title} {quantity.text_of(best.document)} against {second:.{quantity.digits}f} {quantity.unit}"
    return f"{text.rstrip()}{_uncertain(quantity)}"


def _within_noise(sound: Sequence[NamedRun], quality: Sequence[Quantity]) -> str:
    """Return the range of the first measure that all maps have, and by how much it is uncertain; may be empty."""
    for quantity in (P95, REVISITS):
        values = [v for e in sound if (v := quantity.of(e.document)) is not None]
        if quantity in quality and len(values) == len(sound):
            low, high = (f"{value:.{quantity.digits}f}" for value in (min(values), max(values)))
            spread = low if low == high else f"{low} to {high}"
            return f" ({quantity.title} {spread} {quantity.unit}{_uncertain(quantity)})"
    return ""


def _uncertain(quantity: Quantity) -> str:
    return f", uncertain by {100 * quantity.noise:.0f} %" if quantity.noise else ""


def _finer(sound: Sequence[NamedRun], best: NamedRun | None = None) -> str:
    """Say whether a finer grid pays, where all runs are of one method with several grids; ``best`` is the best run."""
    if len({run.document.get("method") for run in sound}) > 1 or len(set(map(tables.fineness, sound))) < 2:
        return "No setting stands out: " if best is None else ""
    pays = best is not None and tables.coarsest(sound, best) is not best
    return f"A finer grid {'pays' if pays else 'does not pay'} on this log: "


def _list(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _cost(sound: Sequence[NamedRun], best: NamedRun) -> str:
    times, coarse = tables.relative_cost(sound, best), tables.coarsest(sound, best)
    if coarse is best:
        return ""
    seconds = TIME.of(best.document), TIME.of(coarse.document)
    clock = "" if None in seconds else f" and {seconds[0]:.1f} s of processor time against {seconds[1]:.1f} s"
    return "" if times is None else f"It costs {times:.1f} times the evaluations of {coarse.name}{clock}."


def _fewest_evaluations(sound: Sequence[NamedRun]) -> str:
    if any(e.document.get("method") == EXTERNAL for e in sound):
        return ""
    evaluations = [number(e.document, "search.evaluations_per_scan.mean") or float("inf") for e in sound]
    cheapest = [e.name for e, number_of in zip(sound, evaluations, strict=True) if number_of == min(evaluations)]
    return f"; {cheapest[0]} needs the fewest evaluations" if len(cheapest) == 1 else ""
