"""The section `tracking` of run.json: where the track was lost, and how doubtful it is."""

from __future__ import annotations

from typing import Annotated

from msgspec import Struct, field

from mavnav.metrics.fields import Measured, absent, number, text


class Interval(Struct, frozen=True):
    """A stretch of scans without a pose; times from the first scan."""

    start_s: Annotated[float, number("first scan without a pose")]
    end_s: Annotated[float, number("last scan without a pose")]
    scans: Annotated[int, number("scans without a pose")]
    recovered: Annotated[bool, text("whether tracking came back")]


class DoubtReason(Struct, frozen=True):
    """A reason to doubt the track, and where it holds; times from the first scan."""

    reason: Annotated[str, text("evidence of an error")]
    from_s: Annotated[float, number("first scan that shows it")]
    to_s: Annotated[float, number("last scan that shows it")]
    value: Annotated[float, number("strength: 1 is much", better="lower")]


class DoubtSection(Struct, frozen=True):
    """Whether trajectory or map may be wrong although the scans were accepted (docs/method.md, "Doubt").

    The strongest reason comes first; ``tried`` is what was done because of the doubt. ``probability`` is null on line,
    in a known map and for methods without a final pass.
    """

    probability: Annotated[
        Measured, number("probability that the track is off by 0.2 m or 5 deg somewhere", title="doubt", better="lower")
    ]
    reasons: Annotated[list[DoubtReason], text("strongest first")]
    tried: Annotated[list[str], text("what was done because of the doubt")]


class OtherTrack(Struct, frozen=True):
    """Another track of the log, with one thing changed. ``kept``: it replaced the track before it."""

    name: Annotated[str, text("what was changed")]
    kept: Annotated[bool, text("whether the other track was kept")]


class TrackedPart(Struct, frozen=True):
    """A stretch of scans with a map of its own at first; times from the first scan.

    ``joined``: its scans are in the map and in the trajectory of the run.
    """

    from_s: Annotated[float, number("first scan with a pose in the map of the part")]
    to_s: Annotated[float, number("last scan with a pose in the map of the part")]
    scans: Annotated[int, number("scans with a pose in the map of the part")]
    joined: Annotated[bool, text("whether its scans are in the map and in the trajectory")]


class Tracking(Struct, frozen=True):
    """Where the track was lost; ``lost`` means for good. ``frames`` are parent and child of each trajectory file.

    ``parts`` is absent where one map holds all tracked scans from the first usable one on, ``attempts`` where the log
    was tracked once.
    """

    lost: Annotated[bool, text("whether tracking was lost for good")]
    intervals: Annotated[list[Interval], text("stretches of scans without a pose")]
    tracked_share: Annotated[float, number("part of the processed scans with a pose", better="higher")]
    opinions: Annotated[int, number("tracks compared, of which the sharpest was kept")]
    path_length_m: Annotated[float, number("length of the path of the laser, standstill noise left out", title="path")]
    doubt: DoubtSection
    frames: Annotated[dict[str, list[str]], text("parent and child frame of each trajectory file")]
    parts: Annotated[list[TrackedPart], text("stretches with maps of their own, joined or not")] = field(
        default_factory=absent
    )
    attempts: Annotated[list[OtherTrack], text("other tracks of the log, each with one thing changed")] = field(
        default_factory=absent
    )
