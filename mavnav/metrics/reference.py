"""The comparison of a run with references: the section ``reference`` of run.json."""

from typing import Annotated

from msgspec import Struct, field

from mavnav.metrics.fields import Measured, absent, number
from mavnav.metrics.map_distance import MapDistance
from mavnav.metrics.relations import RelationErrors
from mavnav.metrics.trajectory_error import RelativeError


class AlignedError(Struct, frozen=True):
    """Absolute trajectory error against the truth (Sturm et al. 2012), after the best rigid motion."""

    alignment: str
    poses: Annotated[int, number("poses that have a truth")]
    rmse_m: Annotated[
        Measured,
        number(
            "absolute trajectory error against the truth, root mean square, after alignment",
            title="ATE",
            better="lower",
        ),
    ]
    median_m: Annotated[Measured, number("median of the errors, after alignment")]
    max_m: Annotated[Measured, number("largest of the errors, after alignment")]
    share: Annotated[float, number("part of the poses that have a truth")]
    unaligned_rmse_m: Annotated[Measured, number("root mean square of the errors, without alignment")]


class Reference(Struct, frozen=True):
    """Errors against references besides the log; a key for each reference that was given.

    ``ate`` and ``rpe`` are null if too few poses have a truth.
    """

    ate: AlignedError | None = field(default_factory=absent)
    rpe: RelativeError | None = field(default_factory=absent)
    map_distance: MapDistance = field(default_factory=absent)
    relations: dict[str, RelationErrors] = field(default_factory=absent)
