"""A track: the steps and the map of one pass over a log, and the inputs of that pass."""

from __future__ import annotations

from functools import partial
from itertools import chain, islice
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from mavnav.pose import Pose
from mavnav.slam.findings import Loops
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods.registry import make_method
from mavnav.slam.tracker import track

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from mavnav.config.models import Config
    from mavnav.scan import Scan
    from mavnav.slam.findings import Doubt
    from mavnav.slam.matching.motion_model import Motion
    from mavnav.slam.matching.prior_map import PriorMap
    from mavnav.slam.methods.method import Method, Refiner

    LogScans = Callable[[], Iterable[Scan]]
    """Return the scans of a log; every call starts at the first scan."""
    OnStep = Callable[[str, int], None]
    """Called with the name of the pass ("track", "track again", "close loops", "final pass") and the scans done."""
    Pass = Callable[["Track"], "Track"]
    """Return the track after a pass, unchanged where the pass does not apply."""
    Until = Callable[[Iterable[Step]], Iterator[Step]]
    """Yield the steps of a track up to the one that ends it."""


class Track(Struct, frozen=True):
    """A pass of the tracker over a log.

    ``motion`` is the state before the first scan, with the odometry that is used. ``warnings`` are lines for the user.
    ``tracks_compared`` counts the tracks that were compared for the sharper map. The map begins with the first usable
    scan from number ``begin`` on. ``parts`` are the accepted steps of each stretch that was tracked on a separate map.
    ``odometry_contradicts``: the log has odometry, but it contradicts the scans and is not used. ``observed`` and
    ``conflicts`` (n,) are the observability and the visibility conflicts of the steps in the finished map, ``hessians``
    (n, 6) their Hessians, from which covariances are computed; empty before the final pass. ``by_odometry_m`` (n,) is
    the error to be expected of the steps that are placed by odometry alone, 0 for the others; empty without parts.
    """

    log_scans: LogScans
    config: Config
    motion: Motion
    method: Method
    steps: Steps = field(default_factory=Steps)
    prior_map: PriorMap | None = None
    on_step: OnStep | None = None
    loops: Loops = field(default_factory=Loops)
    warnings: tuple[str, ...] = ()
    tracks_compared: int = 1
    begin: int = 0
    parts: tuple[tuple[Step, ...], ...] = ()
    odometry_contradicts: bool = False
    observed: NDArray[np.float64] = field(default_factory=partial(np.zeros, 0))
    conflicts: NDArray[np.float64] = field(default_factory=partial(np.zeros, 0))
    hessians: NDArray[np.float64] = field(default_factory=partial(np.zeros, (0, 6)))
    doubt: Doubt | None = None
    by_odometry_m: NDArray[np.float64] = field(default_factory=partial(np.zeros, 0))

    @property
    def refiner(self) -> Refiner | None:
        """Refiner for the passes after tracking; None if the method has none, or in causal mode."""
        return self.method.refiner if self.config.final_pass else None

    @property
    def builds_map(self) -> bool:
        """Whether passes after tracking may change the map: they run, and the map is not given."""
        return self.refiner is not None and self.refiner.builds_map

    def with_warning(self, text: str) -> Track:
        """Return the track with one more warning for the user."""
        return replace(self, warnings=(*self.warnings, text))

    def over(self, scans: Iterable[Scan], phase: str = "", until: Until | None = None) -> Track:
        """Track scans from an empty map, or in the prior map; report progress if the phase has a name.

        The steps of the scans before ``begin`` have no pose. ``until`` may end the track early.
        """
        method, coming = make_method(self.config, self.prior_map), iter(scans)
        before = (
            Step(k, s.stamp_ns, no_match(Pose()), tracked=False) for k, s in enumerate(islice(coming, self.begin))
        )
        steps: Iterator[Step] = chain(before, track(coming, method, self.motion, self.begin))
        steps = until(steps) if until else steps
        return replace(self, method=method, steps=Steps(self.reported(steps, phase) if phase else steps))

    def again(self, other: Track) -> Track | None:
        """Track the whole log with the settings of ``other``; None if the run is stopped before the end."""
        found = other.over(other.log_scans(), "track again")
        return found if len(found.steps) == len(self.steps) else None

    def reported(self, steps: Iterable[Step], phase: str) -> Iterator[Step]:
        """Yield the steps of a pass, and report the progress at each."""
        for done, step in enumerate(steps, start=1):
            if self.on_step:
                self.on_step(phase, done)
            yield step
