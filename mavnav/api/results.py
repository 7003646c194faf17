"""Finished runs and comparisons: their directories, and what is in them."""

from __future__ import annotations

import csv
import shutil
import weakref
from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, Final, TypeVar

import numpy as np
from PIL import Image

from mavnav.api.arguments import path_of, with_python_names
from mavnav.atomic_files import naming_full_disk
from mavnav.config.named_files import read_json
from mavnav.config.options import File
from mavnav.errors import UsageError
from mavnav.ground_truth.tables import read_tum
from mavnav.mapping.occupancy_grid import Grid, occupancy
from mavnav.outputs.directory import RUN_FILE, atomic_directory, checked_file, digests_of
from mavnav.outputs.files.gridmap import HITS_FILE, read_npz
from mavnav.pose import Trajectory

TEXTS: Final = ("refused_by",)
"""Columns of trajectory.csv that are no numbers."""

KINDS: Final = dict.fromkeys(("index", "beams_used", "evaluations", "iterations"), int) | dict.fromkeys(
    ("converged", "tracked", "accepted", "doubtful"), bool
)
"""Columns of trajectory.csv that are whole numbers, or true or false."""

UNKNOWN_SHADE: Final = 0.85
"""Grey of unknown cells, between black 0 and white 1."""


@dataclass(frozen=True)
class Run:
    """A finished run: its directory, and what is in it.

    A run that was given no directory has a temporary one, which goes with this object; `save` keeps it.
    """

    directory: Path
    _owner: object = field(default=None, repr=False, compare=False)

    def __fspath__(self) -> str:
        """Return the directory, so that a run can be given wherever a path can."""
        return str(self.directory)

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """run.json: ``wall_thickness``, ``map_quality``, ``tracking`` and more, as docs/metrics.md describes."""
        document: dict[str, Any] = read_json(self.directory / RUN_FILE)
        return document

    @cached_property
    def trajectory(self) -> Trajectory:
        """The poses of the laser in the map frame: ``stamps_ns`` (n,) int64, ``xyyaw`` (n, 3) in m, m, rad."""
        return read_tum(self.file("trajectory.tum"))

    @cached_property
    def map(self) -> Grid:
        """The occupancy grid: counts of ``hits`` and ``passes`` (rows, cols), ``cell_m``, ``origin_xy_m``.

        The lower left corner of the cell ``hits[row, col]`` is ``origin_xy_m + cell_m * (col, row)``, map frame.
        """
        return read_npz(self.file(HITS_FILE))

    def file(self, name: str) -> Path:
        """Return the path of a file of the run; raises UsageError where it is not the one that was written."""
        return checked_file(self.directory, name, digests_of(self.directory))

    @property
    def lost(self) -> bool:
        """Whether tracking was lost for good."""
        return bool(self.metrics.get("tracking", {}).get("lost"))

    @property
    def verdict(self) -> dict[str, str]:
        """Whether the run can be used: ``word`` (good, suspect, wrong or lost), ``reason`` and ``advice``."""
        return dict(self.metrics["verdict"])

    @property
    def doubt(self) -> float | None:
        """The probability, 0 to 1, that the trajectory is wrong although it was tracked; None if it was not judged."""
        doubt = self.metrics.get("tracking", {}).get("doubt")
        probability: float | None = doubt and doubt["probability"]
        return probability

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was odd about the log or the run, a line each."""
        return tuple(self.metrics["warnings"])

    def columns(self) -> dict[str, list[str]]:
        """Return trajectory.csv: for each column the values of all scans as text, of numbers that are not known nan."""
        with self.file("trajectory.csv").open(encoding="ascii", newline="") as file:
            names, *rows = list(csv.reader(file))
        return {name: [row[k] or ("" if name in TEXTS else "nan") for row in rows] for k, name in enumerate(names)}

    def frame(self) -> Any:  # noqa: ANN401  pandas is no dependency
        """Return trajectory.csv as a pandas.DataFrame: a row for every scan, tracked or not, indexed by time (UTC).

        Units are in the names of the columns, which docs/cli.md describes. Raises ImportError without pandas.
        """
        import pandas as pd  # noqa: PLC0415  optional

        columns = self.columns()
        stamps_ns = [int(text.replace(".", "")) for text in columns.pop("stamp")]  # nine decimals
        numbers = {name: texts if name in TEXTS else [*map(float, texts)] for name, texts in columns.items()}
        return pd.DataFrame(numbers, index=pd.to_datetime(stamps_ns, unit="ns", utc=True)).astype(
            {name: kind for name, kind in KINDS.items() if name in numbers}
        )

    def plot(self, axes: Any = None) -> Any:  # noqa: ANN401  matplotlib is no dependency
        """Draw the map and the path, doubtful stretches in red, into axes of matplotlib, and return these.

        Without matplotlib (the extra ``plot``), map.png is returned as an image of Pillow.
        """
        try:
            from matplotlib import pyplot  # noqa: PLC0415  optional
        except ImportError:
            with Image.open(self.file("map.png"), formats=("PNG",)) as picture:
                return picture.convert("RGB")
        columns, verdict, grid, axes = self.columns(), self.verdict, self.map, axes or pyplot.subplots()[1]
        xy_m = np.array([columns["x_m"], columns["y_m"]], np.float64).T
        doubtful = np.array(columns["doubtful"], np.float64) > 0
        cells, (rows, cols), (x_m, y_m) = occupancy(grid), grid.hits.shape, grid.origin_xy_m
        extent = (x_m, x_m + cols * grid.cell_m, y_m, y_m + rows * grid.cell_m)
        shade = np.where(cells > 0, 0.0, np.where(cells == 0, 1.0, UNKNOWN_SHADE))
        axes.imshow(shade, origin="lower", extent=extent, cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest")
        axes.plot(*xy_m.T, color="tab:blue", linewidth=1)
        if doubtful.any():
            axes.plot(*np.where(doubtful[:, None], xy_m, np.nan).T, color="tab:red", linewidth=2, label="may be wrong")
            axes.legend()
        axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
        axes.set_title(f"{verdict['word']}: {verdict['reason']}", wrap=True)
        return axes

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the verdict and the map."""
        verdict = self.verdict
        advice = f"<br>{escape(verdict['advice'])}" if verdict.get("advice") else ""
        text = f"<p><b>{escape(verdict['word'])}</b>: {escape(verdict['reason'])}{advice}</p>"
        if "map.png" not in self.metrics["outputs"]:
            return text
        data = b64encode(self.file("map.png").read_bytes()).decode("ascii")
        return f'{text}<img alt="map" style="max-width: 100%" src="data:image/png;base64,{data}">'

    @with_python_names
    def save(self, directory: File, *, force: bool = False) -> Run:
        """Copy the run to a directory, and return the run there.

        Raises OutputError if the directory exists (and ``force`` does not say to replace it) or cannot be written.
        """
        target = path_of(directory, "directory")
        with atomic_directory(target, force=force) as folder:
            shutil.copytree(self.directory, folder, dirs_exist_ok=True)
        return Run(target)


@dataclass(frozen=True)
class Comparison:
    """A finished comparison or batch: its directory, its document, and the runs that did not fail."""

    directory: Path
    document: dict[str, Any] = field(repr=False)

    @cached_property
    def runs(self) -> dict[str, Run]:
        """The runs by name, in the order of the table; those that failed are left out."""
        cells = self.document["cells"]
        return {cell["name"]: Run(self.directory / cell["directory"], self) for cell in cells if cell["directory"]}


Result = TypeVar("Result", Run, Comparison)


def in_directory(work: Callable[[Path], Result], directory: File | None) -> Result:
    """Return the result of work that writes to a directory; a temporary one goes with the result."""
    if directory is not None:
        return work(path_of(directory, "directory"))
    folder = mkdtemp(prefix="mavnav-")
    try:
        with naming_full_disk(Path(folder)):
            result = work(Path(folder) / "run")
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(result, shutil.rmtree, folder, ignore_errors=True)
    return result


def load_run(directory: File) -> Run:
    """Open the directory of a finished run, of this interface or of a command; raises UsageError if it is none."""
    run = Run(path_of(directory, "directory"))
    if not (run.directory / RUN_FILE).is_file():
        raise UsageError(f"{directory} holds no run (no {RUN_FILE}); name a run directory")
    return run
