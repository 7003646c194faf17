"""What is said where tracking was lost for good: since when, for how much of the log, and what to try."""

from __future__ import annotations

from typing import Any

_FEW_BEAMS = 20
"""A scan of fewer returns hardly separates one pose from another."""

_LARGE_PARTS = 0.1
"""Share of the scans from which parts that are left out are worth a replay of their own."""

_MOST_NAMED = 3
"""Number of settings that are named."""


def lost_line(document: dict[str, Any]) -> str:
    """Say that the track was lost for good: since when, for how much of the log, and what to try."""
    poses = f"{100 * document['tracking']['tracked_share']:.0f} % of the scans have a pose"
    since = _lost_since(document["tracking"]["intervals"])
    if "localisation" in document:
        return (
            f"mavnav: error: the laser was lost for good in the map{since}, {poses}; see whether the map is of this "
            f"place, and try {'another' if document['localisation']['start_pose'] else 'a'} --start-pose"
        )
    beams = _usable_beams(document)
    if beams < _FEW_BEAMS:
        return (
            f"mavnav: error: the scans see too little to be matched ({beams:.0f} usable beams in the median); "
            "what could be tracked is written, look at the ranges with 'mavnav info', and at near_mm and far_mm"
        )
    return (
        f"mavnav: error: tracking was lost for good{since}, {poses}; what could be tracked is written, "
        f"{_advice(document)}, and look at map.png"
    )


def _usable_beams(document: dict[str, Any]) -> float:
    """Return the usable beams of the median scan: those that were matched, or the valid ones where most were not."""
    matched: float = document["search"]["beams_used"]["median"] or 0
    usable = max(document["scans"]["usable"], 1)
    return matched or float(document["cleaning"].get("valid", 0)) / usable


def _advice(document: dict[str, Any]) -> str:
    """Say what helps where tracking was lost for good."""
    if changed := _changed_settings(document):
        return f"try without {changed}"
    if document["method"] == "paper":
        return "try --method robust"
    left_out = sum(part["scans"] for part in document["tracking"].get("parts", []) if not part["joined"])
    if left_out >= _LARGE_PARTS * document["scans"]["processed"]:
        return "replay the parts that are left out alone with --start and --end"
    if document["config"]["odom"] == "off":
        return "try --odom auto if the log has odometry"
    record = "more scans a second" if document["input"]["odometry"] else "odometry, or more scans a second"
    return f"look at the sensor with 'mavnav info', record {record}"


def _changed_settings(document: dict[str, Any]) -> str:
    """Name the settings of the method that are not its defaults, with their defaults."""
    from mavnav.config.layers import by_dotted_key
    from mavnav.config.loading import load_config

    method = document["method"]
    usual = by_dotted_key(load_config(None, [], {"method": method}).document())
    used = by_dotted_key({method: document["config"].get(method, {})})
    names = [
        name for name, value in used.items() if value != usual.get(name, value) and not _is_farther(name, value, usual)
    ]
    return ", ".join(f"{name}={used[name]} (default {usual[name]})" for name in names[:_MOST_NAMED])


def _is_farther(name: str, value: Any, usual: dict[str, Any]) -> bool:  # noqa: ANN401
    """Return whether a setting uses more of the returns: fewer help no track."""
    return name.endswith(".far_mm") and value > usual[name]


def _lost_since(intervals: list[dict[str, Any]]) -> str:
    """Say when the track ended; nothing where it came back, for too few of the scans."""
    if not intervals or intervals[-1]["recovered"]:
        return ""
    return f" {intervals[-1]['start_s']:.1f} s after the first scan"
