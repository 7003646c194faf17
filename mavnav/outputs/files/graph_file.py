"""pose_graph.g2o: the key frames, the motion between them and the closed loops, for g2o, GTSAM and Ceres."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mavnav.outputs.run import RunResult
    from mavnav.slam.findings import Edge


def write(run: RunResult, path: Path) -> None:
    """Write a vertex for every key frame, numbered as its scan in trajectory.csv, at its final pose; m, rad."""
    path.write_text("".join(_lines(run)), encoding="ascii")


def _lines(run: RunResult) -> Iterator[str]:
    graph = run.slam.loops.graph
    if graph is None:
        msg = "no loops were looked for"
        raise ValueError(msg)
    numbers = run.slam.steps.column("index")[run.slam.steps.column("tracked")]
    names = numbers[list(graph.rows)].tolist()
    for name, (x, y, yaw) in zip(names, run.slam.trajectory.xyyaw[list(graph.rows)].tolist(), strict=True):
        yield f"VERTEX_SE2 {name} {x:z.9f} {y:z.9f} {yaw:z.9f}\n"
    yield f"FIX {names[0]}\n"
    for edge in graph.edges:
        yield f"EDGE_SE2 {names[edge.start]} {names[edge.end]} {_edge_values(edge)}\n"


def _edge_values(edge: Edge) -> str:
    """Return the pose of the end seen from the start, and the upper triangle of the information matrix."""
    x, y, yaw = edge.start_T_end
    information = edge.sqrt_information.T @ edge.sqrt_information
    upper = information[np.triu_indices(3)].tolist()
    return " ".join([f"{x:z.9f} {y:z.9f} {yaw:z.9f}", *(f"{value + 0.0:.9g}" for value in upper)])
