"""What every page says of a run in a line: when it was made, how long its log is, and what the sensor was."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


def facts(documents: Sequence[Mapping[str, Any]]) -> str:
    """Describe the runs of one log, given run.json of each; what an earlier version did not write is left out.

    Runs of several days give the first and the last.
    """
    if not documents:
        return ""
    log_input = documents[0].get("input") or {}
    length_s = log_input.get("duration_s")
    parts = [_dates(documents), "" if length_s is None else f"log of {length_s:.1f} s", _sensor(log_input)]
    return " · ".join(part for part in parts if part)


def _dates(documents: Sequence[Mapping[str, Any]]) -> str:
    """Write the times of runs to the minute; only days where they are not of one minute."""
    texts = sorted(str((run.get("provenance") or {}).get("started") or "") for run in documents)
    days, minutes = ([text[:length] for text in texts if text] for length in (10, 16))
    if not days:
        return ""
    if minutes[0] == minutes[-1]:
        return f"{minutes[0].replace('T', ' ')} UTC"
    return days[0] if days[0] == days[-1] else f"{days[0]} to {days[-1]}"


def _sensor(log_input: Mapping[str, Any]) -> str:
    sensor = log_input.get("sensor")
    if not sensor:
        return ""
    most_m, rate_hz = sensor["range_max_m"], sensor["rate_hz"]
    reach = f"from {sensor['range_min_m'] or 0.0:.3g} m" + (f" to {most_m:.3g} m" if most_m is not None else "")
    parts = [f"{sensor['beams']} beams", f"{sensor['field_of_view_deg']:.4g} deg", reach]
    parts += [f"{rate_hz:.3g} Hz"] if rate_hz is not None else []
    return ", ".join([*parts, f"frame {log_input['frame_id']}"] if log_input.get("frame_id") else parts)
