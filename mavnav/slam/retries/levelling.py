"""Levelling: scans are levelled by a measured tilt only where that makes the walls sharper.

Sensors read the acceleration of a turn as tilt, have wrong axes or late clocks. Level scans that are tilted by them
blur the map, as those of a tilted laser do where nothing levels them.
"""

from __future__ import annotations

from typing import Final

from msgspec.structs import replace

from mavnav.slam.retries.attempt import Attempt, is_sharper
from mavnav.slam.retries.floor_line import scans_before
from mavnav.slam.track import LogScans, Track

AS_RECORDED: Final = "scans as recorded"

WARNING: Final = (
    "the walls are sharper without the measured tilt of the laser, which is not used: check the sensor's axes and "
    "clock, and whether it takes turns for tilt; --attitude TOPIC uses a topic whatever the walls say"
)


def as_recorded(recorded: LogScans) -> Attempt:
    """Return the attempt to track the scans of a log that are not levelled."""

    def use_recorded(track: Track) -> Track:
        return replace(track, log_scans=scans_before(recorded, track.findings.floor_m)).with_warning(WARNING)

    return Attempt(AS_RECORDED, use_recorded, is_sharper)
