"""foxglove_layout.json: how Foxglove shows result.mcap, map on the left, plots of the pose on the right."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

from mavnav.outputs.files.replay_log import MAP_FRAME

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.outputs.run import RunResult

MAP_PANEL: Final = "3D!map"
PLOTS: Final = {
    "Plot!position": ("position [m]", ("/pose.pose.position.x", "/pose.pose.position.y")),
    "Plot!heading": ("heading (z of the quaternion)", ("/pose.pose.orientation.z",)),
}
"""Panel -> title, and the paths of the messages that it shows."""

TOPICS: Final[dict[str, dict[str, Any]]] = {
    "/map": {"visible": True, "colorMode": "map"},
    "/scan": {"visible": True, "colorMode": "flat", "flatColor": "#d6009a", "pointSize": 3},
    "/path": {"visible": True, "gradient": ["#0033ff", "#0033ff"], "lineWidth": 0.02},
    "/pose": {"visible": True, "axisScale": 0.5, "type": "axis"},
    "/markers": {"visible": True},
}
FIELD_OF_VIEW_DEG: Final = 40.0
"""Of the camera, whose distance shows the whole map."""


def write(run: RunResult, path: Path) -> None:
    """Write the layout as Foxglove imports it."""
    path.write_text(json.dumps(layout(run), indent=2) + "\n", encoding="ascii")


def layout(run: RunResult) -> dict[str, Any]:
    """Return the layout: a map from above, and plots of the pose."""
    plots = {name: _plot(title, values) for name, (title, values) in PLOTS.items()}
    first, second = PLOTS
    return {
        "configById": {MAP_PANEL: _map(run), **plots},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": {
            "direction": "row",
            "first": MAP_PANEL,
            "second": {"direction": "column", "first": first, "second": second, "splitPercentage": 50},
            "splitPercentage": 70,
        },
    }


def _map(run: RunResult) -> dict[str, Any]:
    grid = run.known
    rows, cols = grid.hits.shape
    middle = [o + 0.5 * n * grid.cell_m for o, n in zip(grid.origin_xy_m, (cols, rows), strict=True)]
    return {
        "cameraState": {
            "perspective": False,
            "distance": 1.2 * max(rows, cols) * grid.cell_m,
            "phi": 0,
            "thetaOffset": 90,
            "targetOffset": [*middle, 0],
            "target": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": FIELD_OF_VIEW_DEG,
            "near": 0.1,
            "far": 10_000,
        },
        "followMode": "follow-none",
        "followTf": MAP_FRAME,
        "scene": {"backgroundColor": "#ffffff"},
        "transforms": {},
        "topics": TOPICS,
        "layers": {},
        "publish": {"type": "point"},
    }


def _plot(title: str, values: tuple[str, ...]) -> dict[str, Any]:
    shown = {"enabled": True, "timestampMethod": "headerStamp"}
    paths = [{"value": value, "label": value.rpartition(".")[2], **shown} for value in values]
    return {
        "title": title,
        "paths": paths,
        "xAxisVal": "timestamp",
        "showLegend": True,
        "isSynced": True,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "legendDisplay": "floating",
        "sidebarDimension": 240,
    }
