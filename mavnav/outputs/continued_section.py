"""The section `continued` of run.json: which run was continued, and how the new session was placed in its map."""

from dataclasses import dataclass, field

from mavnav.metrics.fields import Measured, number, text


@dataclass(frozen=True, slots=True)
class EarlierSession:
    """A session of the run that was continued, with its files in this run directory."""

    name: str = field(metadata=text("name of the session"))
    scans: int = field(metadata=number("scans with a pose"))
    trajectory: str = field(metadata=text("file of its poses, in the map frame of this run"))
    recording: str = field(metadata=text("file of its scans"))
    doubtful: bool = field(metadata=text("whether its track was lost for good or doubtful"))


@dataclass(frozen=True, slots=True)
class JoinedTo:
    """A session whose key frames others matched."""

    name: str = field(metadata=text("name of the session"))
    closures: int = field(metadata=number("closures with it"))


@dataclass(frozen=True, slots=True)
class Evidence:
    """How a session was placed in the map of others, as merge.json has it (docs/merge.md)."""

    after: str | None = field(metadata=text("session at whose end it was placed, null if it was found elsewhere"))
    searched: int = field(metadata=number("key frames that were searched in the whole map"))
    found: int = field(metadata=number("of them, those that fit in one place"))
    agreeing: int = field(metadata=number("of them, those that agree"))
    tested: int = field(metadata=number("key frames that closures were searched for"))
    closures: int = field(metadata=number("of them, those that agree with the map"))
    contradicting: int = field(metadata=number("of them, those that contradict the map"))
    overlap: Measured = field(metadata=number("closures as a share of tested, null without any"))
    residual_mm: Measured = field(metadata=number("RMS distance that the closures are left with"))
    residual_deg: Measured = field(metadata=number("RMS angle that the closures are left with"))
    joined_to: list[JoinedTo] = field(metadata=text("sessions that it was joined to"))


@dataclass(frozen=True, slots=True)
class Continued:
    """The run that was continued. If the session did not join it, this run has the session alone, in its own frame."""

    run: str = field(metadata=text("directory of the run that was continued"))
    name: str = field(metadata=text("name of the new session"))
    joined: bool = field(metadata=text("whether the session is in the map of the run"))
    why: str | None = field(metadata=text("why it did not join, null if it did"))
    evidence: Evidence
    sessions: list[EarlierSession] = field(metadata=text("earlier sessions in the map"))
