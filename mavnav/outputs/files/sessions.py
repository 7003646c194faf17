"""The files of a session in a directory of several: its poses in their common frame, and its scans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.logs.messages import cdr, definitions
from mavnav.logs.writing.mcap_writer import OutputChannel, write_serialized
from mavnav.outputs.documents.continued_section import JoinedTo, PlacementEvidence
from mavnav.outputs.files.trajectory import tum_lines
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from mavnav.pose import Trajectory
    from mavnav.scan import Scan
    from mavnav.sessions.group import Join

FRAME = "laser"


def trajectory_file(name: str) -> str:
    """Return the name of the file of the poses of a session."""
    return f"session_{name}.tum"


def recording_file(name: str) -> str:
    """Return the name of the file of the scans of a session."""
    return f"session_{name}.mcap"


def write_poses(map_T_laser: Trajectory, path: Path) -> None:
    """Write poses as TUM."""
    path.write_text("".join(tum_lines(map_T_laser)), encoding="ascii")


def write_scans(scans: Iterable[Scan], path: Path) -> None:
    """Write scans as a log with nothing else in it."""
    message = cdr.scans(FRAME)
    with write_serialized(path, {"/scan": OutputChannel(definitions.SCAN)}) as put:
        for scan in scans:
            put("/scan", scan.stamp_ns, message(scan))


def evidence(join: Join) -> PlacementEvidence:
    """Describe what a session was joined by; of the one that others joined there is none."""
    known = bool(join.closures)
    return PlacementEvidence(
        after=join.after or None,
        searched=join.searched,
        found=join.found,
        agreeing=join.agreeing,
        tested=join.tested,
        closures=join.closures,
        contradicting=join.contradicting,
        overlap=round(join.closures / join.tested, 3) if join.tested else np.nan,
        residual_mm=round(join.residual_m / MM, 1) if known else np.nan,
        residual_deg=round(join.residual_rad / DEG, 3) if known else np.nan,
        joined_to=[JoinedTo(*pair) for pair in join.joined_to],
    )
