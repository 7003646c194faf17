"""The verdict on a run: whether its path and map can be used, the cause if not, and what to do about it.

It follows from run.json alone, so that any run can be judged: from the doubt, the stretches without a pose, the parts
that were left out, and whether the map is meaningful.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import accumulate
from math import ceil, floor
from typing import Annotated, Any, Final, Literal, TypeAlias

from msgspec import Struct

from mavnav.config.layers import by_dotted_key
from mavnav.config.loading import load_config
from mavnav.logs.health import SLOW_HZ
from mavnav.metrics.fields import text
from mavnav.metrics.gates import VERDICTS
from mavnav.slam.findings import HIGH, NOT_PLANAR, SECOND_MOTION
from mavnav.units import pluralize

Run: TypeAlias = Mapping[str, Any]
Cause: TypeAlias = "tuple[str, str] | None"
"""A reason with its advice, None where it does not hold."""

EXTERNAL: Final[Literal["external"]] = "external"
"""Name of the method of a run at poses that another program has given."""

NOTABLE_SCANS: Final = 20
"""Number of scans of a part that is missed if it is left out."""

CERTAIN: Final = 0.75
"""Doubt above which a track is called wrong (so were 9 of 10 of those held out); above `HIGH` it is suspect."""

FEW_BEAMS: Final = 20
"""A scan of fewer returns hardly separates one pose from another."""

LARGE_PARTS: Final = 0.1
"""Share of the scans from which parts that are left out are worth a replay of their own."""

WORTH_A_MAP: Final = 0.15
"""Share of a log from which a stretch without a sign of an error is worth a map of its own."""

MOST_LEFT_OUT: Final = 0.6
"""Share of a log over which a sign of an error cannot be left out."""

MOST_NAMED: Final = 3
"""Maximum number of settings that advice names."""

LOOK: Final = "compare map.png with the place"

IN_MISSIONS: Final = "compare map.png with true_map.png"
"""All that can be done about a mission, whose truth is known."""

TORN, LEAST_PAIRS = 2.2, 100
"""Ratio of the distances at revisits to those of neighbors that a good track does not reach, and pairs that show it.

Of 127 good runs of 81 logs the largest ratio was 2.06.
"""

MISFIT_CELLS: Final = 0.75
"""Distance in cells from where it fits the map that the median scan of a good track does not reach."""

EVERYWHERE: Final = 0.9
"""Share of a log from which a reason holds everywhere."""

SYMPTOM: Final = "two tracks disagree"
OPEN: Final = "weakly constrained pose"

MEANINGS: Final = {
    SYMPTOM: "tracked again with coarser voxels, the path differs",
    "a second track is lost": "tracked again with coarser voxels, the laser is lost",
    "slip": "the path jumps",
    OPEN: "the walls leave a direction open",
    "sampling too sparse for the motion": "the laser moves too far between two scans",
    NOT_PLANAR: "the laser seems to have tilted, or the place to have changed",
    "too few beams": "the scans have few points",
    SECOND_MOTION: "something large moves with the laser or past it",
    "placed by odometry alone": "a part is placed by odometry alone",
    "may have been carried": "after a stretch without poses, the laser may be elsewhere",
    "odometry contradicts": "odometry shows another motion",
}
"""Reason of the doubt -> what it says of the run."""


class Verdict(Struct, frozen=True):
    """Whether path and map can be used: ``good``; ``suspect``, look first; ``wrong``, do not; ``lost``, hardly any."""

    word: Annotated[Literal["good", "suspect", "wrong", "lost"], text("good, suspect, wrong or lost")]
    reason: Annotated[str, text("the cause")]
    advice: Annotated[str, text("what to do about it, empty for a good run")]


def verdict_of(run: Run) -> Verdict:
    """Return the verdict on a run, of the sections of its run.json; sections that are missing say nothing."""
    for word, cause in RULES:
        if (known := cause(run)) is not None:
            reason, advice = known
            return Verdict(word, reason, IN_MISSIONS if run.get("mission") else advice)
    judged = "path or map" if run.get("map_quality") else "the path"
    return Verdict("good", f"no sign of an error in {judged}", "")


def map_verdict(run: Run) -> Verdict | None:
    """Return the verdict on a map alone, by its ``map_quality``; None if it can be measured."""
    known = _meaningless(run)
    return Verdict("suspect", *known) if known else None


def worst_verdict(verdicts: Iterable[Verdict]) -> Verdict | None:
    """Return the worst of some verdicts, the first of equal ones; None without any."""
    return max(verdicts, key=lambda verdict: VERDICTS.index(verdict.word), default=None)


def _not_joined(run: Run) -> Cause:
    continued = run.get("continued")
    if not continued or continued["joined"]:
        return None
    why = f"{continued['name']} did not join {continued['run']}: {continued['why']}; it is alone in a frame of its own"
    return why, joining_advice(continued["why"], run["scans"]["tracked"])


def joining_advice(why: str, tracked: int) -> str:
    """Return what to do about a session with so many tracked scans that did not join for a reason."""
    if not tracked:
        return "examine it with mavnav info"
    if "has the scans of" in why:
        return "leave it out: its scans are in the map already"
    return "record it along 3 m or more of the way of another session"


def _lost(run: Run) -> Cause:
    """Say of a track that was lost for good since when, for how much of the log, and what to try."""
    tracking = run["tracking"]
    if not tracking["lost"]:
        return None
    poses = f"{100 * tracking['tracked_share']:.0f} % of the scans have a pose"
    if run["method"] == EXTERNAL:
        return f"only {poses}", "give a trajectory of the whole log, with the clock of its scans"
    since = _since(tracking["intervals"])
    if known := run.get("localisation"):
        another = "another" if known["start_pose"] else "a"
        advice = f"check that the map is of this place; give {another} --start-pose"
        return f"the laser was lost in the map{since}, {poses}", advice
    beams = _usable_beams(run)
    if beams < FEW_BEAMS:
        seen = f"the scans see too little to be matched ({pluralize(round(beams), 'usable beam')} in the median)"
        return seen, _without_changes(run) or "look at the ranges with mavnav info, and at near_mm and far_mm"
    return f"tracking was lost{since}, {poses}", f"{_advice_if_lost(run)}; look at map.png"


def _usable_beams(run: Run) -> float:
    """Return the usable beams of the median scan: those that were matched, or the valid ones where most were not."""
    matched: float = run["search"]["beams_used"]["median"] or 0
    return matched or float(run["cleaning"].get("valid", 0)) / max(run["scans"]["usable"], 1)


def _since(intervals: list[dict[str, Any]]) -> str:
    """Say when the track ended; nothing where it came back, for too few of the scans."""
    ended = intervals and not intervals[-1]["recovered"]
    return f" {intervals[-1]['start_s']:.1f} s after the first scan" if ended else ""


def _advice_if_lost(run: Run) -> str:
    if changed := _without_changes(run):
        return changed
    if run["method"] == "paper":
        return "use --method robust"
    left_out = sum(part["scans"] for part in run["tracking"].get("parts", []) if not part["joined"])
    if left_out >= LARGE_PARTS * run["scans"]["processed"]:
        return "replay the parts that are left out alone with --start and --end"
    if run["config"]["odom"] == "off":
        return "use --odom auto if the log has odometry"
    record = "more scans a second" if run["input"]["odometry"] else "odometry, or more scans a second"
    if stretch := _longest_stretch(run, run["tracking"]["intervals"], "start_s", "end_s"):
        slow = run["scans"]["processed"] < SLOW_HZ * run["input"]["duration_s"]
        return f"map what has poses alone, with {stretch}" + (f"; record {record}" if slow else "")
    return f"look at the sensor with mavnav info; record {record}"


def _without_changes(run: Run) -> str:
    """Advise to leave out the settings of the method that are not its defaults; empty where all are."""
    method = run["method"]
    if method == EXTERNAL:
        return LOOK
    usual = by_dotted_key(load_config(None, [], {"method": method}).document())
    used = by_dotted_key({method: run["config"].get(method, {})})
    changed = [name for name, value in used.items() if value != usual.get(name, value)]
    names = [name for name in changed if not _is_looser(name, used[name], usual)]
    named = ", ".join(f"{name}={used[name]} (default {usual[name]})" for name in names[:MOST_NAMED])
    return named and f"leave out {named}"


def _is_looser(name: str, value: Any, usual: dict[str, Any]) -> bool:  # noqa: ANN401
    """Return whether a setting uses more of the returns, or allows faster motion: less helps no track."""
    return name.endswith((".far_mm", ".max_speed_m_s", ".max_turn_deg_s")) and value > usual[name]


def _doubted(run: Run, above: float, how: str) -> Cause:
    """Say of a track with a higher doubt what raises it most, and where.

    What walls leave open alone makes no poses wrong that another program has given: it may know more than the scans.
    """
    doubt = run["tracking"]["doubt"]
    is_open = run["method"] == EXTERNAL and {each["reason"] for each in doubt["reasons"]} == {OPEN}
    if (doubt["probability"] or 0.0) <= above or (is_open and above >= CERTAIN):
        return None
    return f"the path {how} (doubt {doubt['probability']:.2f}): {_evidence(run)}", _advice_if_doubted(run)


def _evidence(run: Run) -> str:
    """Return what the strongest reason of the doubt says, and where it is strongest; that two tracks differ comes last.

    It is a symptom of the others.
    """
    if seen := _differences(run.get("external") or {}):
        return seen
    reasons = run["tracking"]["doubt"]["reasons"]
    causes = [each for each in reasons if each["reason"] != SYMPTOM] or reasons
    if not causes:
        return "many weak signs together"
    most = max((each for each in causes if each["reason"] == causes[0]["reason"]), key=lambda each: each["value"])
    from_s, to_s = most["from_s"], most["to_s"]
    where = f", at {from_s:.1f} s" if to_s - from_s < 1.0 else f", from {from_s:.1f} to {to_s:.1f} s"
    where = "" if to_s - from_s >= EVERYWHERE * run["input"]["duration_s"] else where
    return f"{MEANINGS.get(most['reason'], most['reason'])}{where}"


def _advice_if_doubted(run: Run) -> str:
    if changed := _without_changes(run):
        return changed
    if run["config"]["odom"] == "off" and run["method"] == "robust":
        return f"use --odom auto if the log has odometry; {LOOK}"
    if sound := _longest_stretch(run, run["tracking"]["doubt"]["reasons"], "from_s", "to_s"):
        return f"map a part alone, with {sound}; {LOOK}"
    return LOOK if run["input"]["odometry"] else f"{LOOK}; record odometry"


def _longest_stretch(run: Run, marked: Sequence[Mapping[str, Any]], from_key: str, to_key: str) -> str:
    """Return the options that replay the longest stretch of a log outside of those marked; empty if it is short.

    They count from the first scan of the log. What is marked over most of it cannot be left out.
    """
    spans = [(each[from_key], each[to_key]) for each in marked]
    spans = sorted(span for span in spans if span[1] - span[0] <= MOST_LEFT_OUT * run["input"]["duration_s"])
    starts = [0.0, *accumulate((to_s for _, to_s in spans), max)]
    stretches = zip(starts, [*(from_s for from_s, _ in spans), run["input"]["duration_s"]], strict=True)
    start_s, end_s = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    worth = spans and end_s - start_s >= WORTH_A_MAP * run["input"]["duration_s"]
    from_s, to_s = (_since_start_of_log(run, at_s) for at_s in (start_s, end_s))
    first = floor if start_s == 0.0 else ceil  # of the run's own start nothing is to be cut off
    return f"--start {first(10.0 * from_s) / 10.0:.1f} --end {floor(10.0 * to_s) / 10.0:.1f}" if worth else ""


def _since_start_of_log(run: Run, at_s: float) -> float:
    """Return a time of a run from the first scan of its log, s, as --start and --end count."""
    return float(run["input"].get("start_s", 0.0)) + at_s


def _ended(run: Run) -> Cause:
    tracking = run["tracking"]
    if not (since := _since(tracking["intervals"])):
        return None
    until_s = floor(10.0 * _since_start_of_log(run, tracking["intervals"][-1]["start_s"])) / 10.0
    poses = f"{100 * tracking['tracked_share']:.0f} % of the scans have a pose"
    advice = f"if the laser was carried or covered there, leave the rest out with --end {until_s:.1f}"
    return f"no scan matches any more from{since}; {poses}", advice


def _leapt(run: Run) -> Cause:
    """Say of a path that no vehicle can have taken where it jumps; of 416 disturbed logs none that was right did."""
    leaps = [each for each in run["tracking"]["intervals"] if not each["scans"]]
    if not leaps:
        return None
    advice = f"see whether its stamps ascend with mavnav info: a clock set back, scans that repeat; {LOOK}"
    return f"the path jumps faster than any vehicle, at {leaps[0]['end_s']:.1f} s", advice


def _left_out(run: Run) -> Cause:
    parts = [part for part in run["tracking"].get("parts", []) if part["scans"] >= NOTABLE_SCANS and not part["joined"]]
    if not parts:
        return None
    from_s, to_s = (_since_start_of_log(run, parts[0][key]) for key in ("from_s", "to_s"))
    start_s, end_s = floor(100.0 * from_s) / 100.0, ceil(100.0 * to_s) / 100.0
    which, are = ("it", "is") if len(parts) == 1 else ("the first", "are")
    scans = pluralize(sum(part["scans"] for part in parts), "scan")
    advice = f"replay {which} alone with --start {start_s:.2f} --end {end_s:.2f}"
    return f"{pluralize(len(parts), 'part')} of the log, {scans}, {are} not in the map", advice


def _meaningless(run: Run) -> Cause:
    quality = run.get("map_quality") or {"meaningful": True}
    if quality["meaningful"]:
        return None
    return f"the map cannot be measured: {'; '.join(quality['why']) or 'too little of it'}", LOOK


def _torn(run: Run) -> Cause:
    """Say of given poses that scans of a place do not fit those of another time, though they fit their neighbors."""
    known = (run.get("map_quality") or {}).get("revisits") or {"pairs": 0}
    if run["method"] != EXTERNAL or known["pairs"] < LEAST_PAIRS:
        return None
    apart_mm, usual_mm = known["nn_l_mm"] or 0.0, known["nn_s_mm"] or 0.0
    if apart_mm <= TORN * usual_mm:
        return None
    return f"places that are seen again are drawn {apart_mm:.0f} mm apart, scans in a row {usual_mm:.0f} mm", LOOK


def _beside(run: Run) -> Cause:
    """Say of given poses that the scans themselves say otherwise."""
    misfit_mm = (run.get("external") or {}).get("misfit_mm")
    if not misfit_mm or misfit_mm <= MISFIT_CELLS * run["config"]["robust"]["cell_mm"]:
        return None
    return f"the median scan fits the map {misfit_mm:.0f} mm beside its pose", LOOK


def _differs(run: Run) -> Cause:
    """Say of given poses how they differ from mavnav's own track."""
    seen = _differences(run.get("external") or {})
    return (seen, f"check the clock and the units of the poses; {LOOK}") if seen else None


def _differences(external: Mapping[str, Any]) -> str:
    late_s, scale = external.get("late_s", 0.0), external.get("distance_scale", 1.0)
    said = [f"the poses are {abs(late_s):.2f} s {'late' if late_s > 0.0 else 'early'} beside the scans"] * bool(late_s)
    if scale != 1.0:
        said.append(f"distances are {100.0 * abs(scale - 1.0):.1f} % {'long' if scale > 1.0 else 'short'}")
    for k, jump in enumerate(external.get("jumps", [])):
        jumped = f"{jump['moved_m']:.2f} m and {jump['turned_deg']:.1f} deg at {jump['at_s']:.1f} s"
        said.append(jumped if k else f"the path jumps where the scans do not, by {jumped}")
    return ", ".join(said)


def _unchecked(run: Run) -> Cause:
    """Say of a track without a doubt why it has none."""
    if run["tracking"]["doubt"]["probability"] is not None:
        return None
    if run.get("partial"):
        return "the run was stopped, its path is not checked", "repeat it"
    return "too few scans to check the path", LOOK


RULES: Final[tuple[tuple[Literal["suspect", "wrong", "lost"], Callable[[Run], Cause]], ...]] = (
    ("lost", _not_joined),
    ("lost", _lost),
    ("wrong", partial(_doubted, above=CERTAIN, how="is probably wrong")),
    ("suspect", _differs),
    ("suspect", partial(_doubted, above=HIGH, how="may be wrong")),
    ("suspect", _ended),
    ("suspect", _leapt),
    ("suspect", _left_out),
    ("suspect", _meaningless),
    ("suspect", _torn),
    ("suspect", _beside),
    ("suspect", _unchecked),
)
"""Verdicts with what they rest on, the worst first; a run to which none applies is good."""
