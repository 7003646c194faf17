"""walls.csv: the cuts across the walls of a map, one a line."""

from __future__ import annotations

import csv
from math import isfinite
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.metrics.wall_spread import WallCuts
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.outputs.run import RunResult

WALLS_FILE: Final = "walls.csv"
COLUMNS: Final = ("x_m", "y_m", "direction_deg", "width_mm", "length_m")


def write(run: RunResult, path: Path) -> None:
    """Write the cuts of a run."""
    write_cuts(run.measured.cuts, path)


def write_cuts(cuts: WallCuts | None, path: Path) -> None:
    """Write a row for each place where the scans saw a wall; the width is empty where the map has none to measure."""
    columns = () if cuts is None else (cuts.xy_m, cuts.direction_rad, cuts.width_m, cuts.length_m)
    with path.open("w", encoding="ascii", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for x, y, direction, width, length in np.column_stack(columns).tolist() if columns else ():
            wide = f"{width / MM:.2f}" if isfinite(width) else ""
            rows.writerow((f"{x:.4f}", f"{y:.4f}", f"{direction / DEG % 180.0:.2f}", wide, f"{length:.4f}"))


def read(path: Path) -> WallCuts:
    """Read the cuts of a run; raises OSError where there is no such file, ValueError where it is another."""
    with path.open(encoding="ascii", newline="") as file:
        rows = list(csv.reader(file))
    if not rows or tuple(rows[0]) != COLUMNS:
        raise ValueError(f"{path.name} has other columns")
    table = np.array([[float(value or "nan") for value in row] for row in rows[1:]], np.float64).reshape(-1, 5)
    return WallCuts(table[:, :2], table[:, 2] * DEG, table[:, 3] * MM, table[:, 4])
