"""Which scan topic of a surveyed log to use, and what to say where there is none."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from mavnav.errors import NoScansError, SeveralTopicsError, TopicError
from mavnav.logs.messages.decode import LASER_TYPES
from mavnav.logs.messages.other_scans import OTHER_TYPES
from mavnav.units import NS

if TYPE_CHECKING:
    from mavnav.logs.stamps import Timeline, TopicScans
    from mavnav.logs.survey import Survey

_MOST_NAMED: Final = 8


def chosen_topic(survey: Survey, topic: str | None) -> str:
    """Return the scan topic to use; several to choose from are listed."""
    if topic is not None and topic not in survey.scans:
        named = [t for t in survey.topics if t.name == topic]
        lasers = {t.name for t in survey.topics if t.type in LASER_TYPES and t.count}
        if not named or survey.scans or (lasers and topic not in lasers):
            raise TopicError(f"{survey.path}: no scans on topic {topic!r}; {_list_topics(survey)}")
    if topic is None and len(survey.scans) > 1:
        raise SeveralTopicsError(f"{survey.path}: several scan topics: {_counts(survey)}; choose one with --topic NAME")
    if not survey.scans:
        raise NoScansError(_no_scans(survey))
    return topic if topic is not None else next(iter(survey.scans))


def _counts(survey: Survey) -> str:
    return _some([f"{name} ({scans.total} scans)" for name, scans in sorted(survey.scans.items())])


def _some(names: list[str]) -> str:
    """List names in a line that a person still reads."""
    return ", ".join(names[:_MOST_NAMED]) + (f" and {len(names) - _MOST_NAMED} more" if names[_MOST_NAMED:] else "")


def _list_topics(survey: Survey) -> str:
    lasers = [f"{t.name} ({t.count} scans)" for t in survey.topics if t.type.endswith("LaserScan")]
    return f"scan topics here: {_some(lasers) or 'none'}"


def _no_scans(survey: Survey) -> str:
    lasers = {topic.name for topic in survey.topics if topic.type in LASER_TYPES and topic.count}
    reason = next((d for d in survey.damage if d.where in lasers or not any(t.count for t in survey.topics)), None)
    if reason is not None:
        return f"{survey.path}: no usable scans; {reason.what} ({reason.where})"
    others = [t.name for t in survey.topics if t.type in OTHER_TYPES and t.count]
    if others:
        return (
            f"{survey.path}: no LaserScan messages; choose the messages to take scans from with --topic: "
            f"{_some(others)}"
        )
    kinds = [f"{t.name} ({t.type or 'no type'} in {t.encoding or 'no encoding'}, {t.count})" for t in survey.topics]
    return f"{survey.path}: no LaserScan messages; topics here: {_some(kinds) or 'none'}"


def no_usable(survey: Survey, name: str, scans: TopicScans, timeline: Timeline) -> str:
    """Say why none of a topic's scans is usable."""
    reasons = ", ".join(
        f"{count} {reason.replace('_', ' ')}" for reason, count in (scans.refused + timeline.skipped).items()
    )
    hint = ""
    if any(end is not None for end in survey.window_s) and len(stamps_ns := scans.timeline().stamps_ns):
        hint = f"; the scans last {(stamps_ns[-1] - stamps_ns[0]) * NS:.1f} s: check --start and --end"
    elif scans.refused["no_valid_beam"] * 2 > scans.total:
        hint = f"; {scans.scan_filter.invalid}"
    return f"{survey.path}: none of the {scans.total} scans on {name} is usable ({reasons}){hint}"
