"""The section `tracking` of run.json: where the track was lost, and how doubtful it is."""

from dataclasses import dataclass, field

from mavnav.metrics.fields import Measured, absent, number, text


@dataclass(frozen=True, slots=True)
class Interval:
    """A stretch of scans without a pose; times from the first scan."""

    start_s: float = field(metadata=number("first scan without a pose"))
    end_s: float = field(metadata=number("last scan without a pose"))
    scans: int = field(metadata=number("scans without a pose"))
    recovered: bool = field(metadata=text("whether tracking came back"))


@dataclass(frozen=True, slots=True)
class DoubtReason:
    """A reason to doubt the track, and where it holds; times from the first scan."""

    reason: str = field(metadata=text("what speaks for an error"))
    from_s: float = field(metadata=number("first scan that shows it"))
    to_s: float = field(metadata=number("last scan that shows it"))
    value: float = field(metadata=number("strength: 1 is much", better="lower"))


@dataclass(frozen=True, slots=True)
class Doubt:
    """Whether trajectory or map may be wrong although the scans were accepted (docs/method.md, "Doubt").

    The strongest reason comes first; ``tried`` is what was done because of the doubt. ``probability`` is null on line,
    in a known map and for methods without a final pass.
    """

    probability: Measured = field(
        metadata=number("probability that the track is off by 0.2 m or 5 deg somewhere", title="doubt", better="lower")
    )
    reasons: list[DoubtReason] = field(metadata=text("strongest first"))
    tried: list[str] = field(metadata=text("what was done because of the doubt"))


@dataclass(frozen=True, slots=True)
class Remedy:
    """Another track of the log, made because the first one was lost or doubtful.

    ``used``: it is the track of the run; ``tracking.doubt`` is then its own. ``doubt_after`` is null where the other
    track was given up, because it was lost as well or had fewer scans.
    """

    remedy: str = field(metadata=text("how the other track was made"))
    doubt_before: float = field(metadata=number("doubt of the first track", better="lower"))
    doubt_after: Measured = field(metadata=number("doubt of the other track", better="lower"))
    used: bool = field(metadata=text("whether it is the track of the run"))


@dataclass(frozen=True, slots=True)
class TrackedPart:
    """A stretch of scans with a map of its own at first; times from the first scan.

    ``joined``: its scans are in the map and in the trajectory of the run.
    """

    from_s: float = field(metadata=number("first scan with a pose in the map of the part"))
    to_s: float = field(metadata=number("last scan with a pose in the map of the part"))
    scans: int = field(metadata=number("scans with a pose in the map of the part"))
    joined: bool = field(metadata=text("whether its scans are in the map and in the trajectory"))


@dataclass(frozen=True, slots=True)
class Tracking:
    """Where the track was lost; ``lost`` means for good. ``frames`` are parent and child of each trajectory file.

    ``parts`` is absent where one map holds all tracked scans from the first usable one on, ``remedies`` where none was
    tried.
    """

    lost: bool = field(metadata=text("whether tracking was lost for good"))
    intervals: list[Interval] = field(metadata=text("stretches of scans without a pose"))
    tracked_share: float = field(metadata=number("part of the processed scans with a pose", better="higher"))
    opinions: int = field(metadata=number("tracks compared, of which the sharpest was kept"))
    path_length_m: float = field(metadata=number("length of the path of the laser", title="path"))
    doubt: Doubt
    frames: dict[str, list[str]] = field(metadata=text("parent and child frame of each trajectory file"))
    parts: list[TrackedPart] = field(
        default_factory=absent, metadata=text("stretches with maps of their own, joined or not")
    )
    remedies: list[Remedy] = field(default_factory=absent, metadata=text("other tracks made because of the doubt"))
