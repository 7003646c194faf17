"""All pictures of the runs of one log: panels for the page, and sheets of panels for files."""

from __future__ import annotations

from collections.abc import Sequence
from string import ascii_uppercase

from msgspec import Struct
from PIL.Image import Image

from mavnav.outputs.documents.quantities import why_not_meaningful
from mavnav.outputs.pictures.map_axes import top_of_scale
from mavnav.outputs.pictures.viewport import Viewport
from mavnav.outputs.report import panels
from mavnav.outputs.report.charts import caption, cost_panels, motion_panel, thickness_panels
from mavnav.outputs.report.closeups import MIN_SIDE_M, differing_places
from mavnav.outputs.report.entry import Entry


class Closeup(Struct, frozen=True):
    """A close-up: its letter, center, side, and its pictures by the names of the runs."""

    letter: str
    x_m: float
    y_m: float
    side_m: float
    images: dict[str, Image]


class Pictures(Struct, frozen=True):
    """The pictures of each kind, one panel per run in their order; ``shape`` is the shape of the maps.

    ``motion`` is drawn only for a single run; ``views_3d`` are those of the runs with slices.
    """

    shape: str
    maps: list[Image]
    legend: Image
    closeups: list[Closeup]
    thickness: list[Image]
    cost: list[Image]
    cost_caption: str
    motion: Image | None
    views_3d: list[Image]

    @property
    def count(self) -> int:
        """Number of pictures on the page."""
        closeups = sum(len(c.images) for c in self.closeups)
        return 3 * len(self.maps) + 1 + (self.motion is not None) + len(self.views_3d) + closeups

    def sheets(self) -> dict[str, Image]:
        """Return the pictures that are also written as files, by name."""
        columns = 1 if self.shape == "wide" else None
        sheets = {
            "maps": panels.stack([panels.sheet(self.maps, columns), panels.sheet([self.legend])]),
            "thickness": panels.sheet(self.thickness),
            "cost": panels.sheet(self.cost),
        }
        if self.motion:
            sheets["motion"] = self.motion
        if self.closeups:
            sheets["closeups"] = panels.stack([panels.sheet(list(c.images.values())) for c in self.closeups])
        return sheets


def draw(entries: Sequence[Entry]) -> Pictures:
    """Draw the runs of one log, all at the same scale.

    Maps that are not meaningful are drawn too, but affect neither scale nor close-ups, unless there are no others.
    """
    sound = [e for e in entries if not why_not_meaningful(e.document)] or entries
    window, top_hits = panels.common_window(sound), top_of_scale(e.grid for e in sound)
    places = differing_places([e.grid for e in sound], window) or _ghost_places(sound)
    alone = len(entries) == 1
    boxes = list(zip(ascii_uppercase, places, strict=False))
    return Pictures(
        shape=panels.shape(window),
        maps=[panels.map_panel(e, window, top_hits, boxes, ends=alone) for e in entries],
        legend=panels.legend_panel(entries, top_hits, ends=alone),
        closeups=[_closeup(letter, box, sound, top_hits) for letter, box in boxes],
        thickness=thickness_panels(entries),
        cost=cost_panels(entries),
        cost_caption=caption(entries),
        motion=motion_panel(entries[0]) if alone else None,
        views_3d=[e.view_3d for e in entries if e.view_3d],
    )


def _ghost_places(entries: Sequence[Entry]) -> list[Viewport]:
    """Return windows around the longest ghost walls, as close-ups of runs without differences."""
    worst = sorted((place for e in entries for place in panels.ghosts(e)), key=lambda p: -p["length_m"])[:3]
    halves = [(p, max(0.75 * p["length_m"], MIN_SIDE_M / 2)) for p in worst]
    return [Viewport(p["x_m"] - h, p["x_m"] + h, p["y_m"] - h, p["y_m"] + h) for p, h in halves]


def _closeup(letter: str, box: Viewport, entries: Sequence[Entry], top_hits: float) -> Closeup:
    images = {e.name: panels.closeup_panel(e, box, top_hits, letter) for e in entries}
    return Closeup(letter, (box.x0_m + box.x1_m) / 2, (box.y0_m + box.y1_m) / 2, box.size_m[0], images)
