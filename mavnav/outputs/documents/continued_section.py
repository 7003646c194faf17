"""The section `continued` of run.json: which run was continued, and how the new session was placed in its map."""

from __future__ import annotations

from typing import Annotated

from msgspec import Struct

from mavnav.metrics.fields import Measured, number, text


class EarlierSession(Struct, frozen=True):
    """A session of the run that was continued, with its files in this run directory."""

    name: Annotated[str, text("name of the session")]
    scans: Annotated[int, number("scans with a pose")]
    trajectory: Annotated[str, text("file of its poses, in the map frame of this run")]
    recording: Annotated[str, text("file of its scans")]
    doubtful: Annotated[bool, text("whether its track was lost for good or doubtful")]


class JoinedTo(Struct, frozen=True):
    """A session whose key frames others matched."""

    name: Annotated[str, text("name of the session")]
    closures: Annotated[int, number("closures with it")]


class PlacementEvidence(Struct, frozen=True):
    """How a session was placed in the map of others, as merge.json has it (docs/merge.md)."""

    after: Annotated[str | None, text("session at whose end it was placed, null if it was found elsewhere")]
    searched: Annotated[int, number("key frames that were searched in the whole map")]
    found: Annotated[int, number("of them, those that fit in one place")]
    agreeing: Annotated[int, number("of them, those that agree")]
    tested: Annotated[int, number("key frames that closures were searched for")]
    closures: Annotated[int, number("of them, those that agree with the map")]
    contradicting: Annotated[int, number("of them, those that contradict the map")]
    overlap: Annotated[Measured, number("closures as a share of tested, null without any")]
    residual_mm: Annotated[Measured, number("RMS distance that the closures are left with")]
    residual_deg: Annotated[Measured, number("RMS angle that the closures are left with")]
    joined_to: Annotated[list[JoinedTo], text("sessions that it was joined to")]


class Continued(Struct, frozen=True):
    """The run that was continued. If the session did not join it, this run has the session alone, in its own frame."""

    run: Annotated[str, text("directory of the run that was continued")]
    name: Annotated[str, text("name of the new session")]
    joined: Annotated[bool, text("whether the session is in the map of the run")]
    why: Annotated[str | None, text("why it did not join, null if it did")]
    evidence: PlacementEvidence
    sessions: Annotated[list[EarlierSession], text("earlier sessions in the map")]
