"""mavnav's own runs of a log beside trajectories of other programs, all drawn and measured alike."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mavnav.comparison.scores import POSES, write_scores
from mavnav.errors import UsageError
from mavnav.ground_truth.tables import read_trajectory
from mavnav.pipelines.score import ScoreRequest, check_names, score_log, scored_options
from mavnav.pipelines.trajectory_source import LASER, RUN_POSES, TrajectorySource

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.batch.cases import CaseResult
    from mavnav.batch.runner import BatchPlan
    from mavnav.pipelines.programs import Program
    from mavnav.profiling import Progress

OWN: Final = "mavnav"
"""Name of the poses of mavnav's run; several are numbered."""


def check_given(plan: BatchPlan, sources: Sequence[TrajectorySource], programs: Sequence[Program]) -> None:
    """Raise UsageError for several logs, names that cannot be used and files without poses, before any run."""
    if len({case.log for case in plan.cases}) > 1:
        raise UsageError("--trajectory and --external are about one log; compare one log at a time with them")
    if own := [name for name in check_names(sources, programs) if name.partition("-")[0] == OWN]:
        raise UsageError(f"{own[0]} names the poses of mavnav's own run; write NAME=FILE with another name")
    for source in sources:
        if source.in_log is None:
            read_trajectory(source.path)


def compare_with_poses(
    plan: BatchPlan,
    own: Sequence[CaseResult],
    sources: Sequence[TrajectorySource],
    programs: Sequence[Program],
    limit_s: float,
    progress: Progress,
) -> dict[str, Any]:
    """Score the poses of mavnav's ``own`` runs and those that are given, and return comparison.json of all.

    Raises as `score_log`.
    """
    request = plan.request
    scored = score_log(
        ScoreRequest(
            Path(plan.cases[0].log),
            request.directory / POSES,
            plan.cases[0].setting.config,
            (*_own_poses(own), *sources),
            scored_options(request.entries[0].options),
            force=True,
            typed=request.typed,
            programs=tuple(programs),
            limit_s=limit_s,
        ),
        progress,
    )
    return write_scores(plan.cases[0].log, scored, request.directory, own, request.rules.gates)


def _own_poses(own: Sequence[CaseResult]) -> list[TrajectorySource]:
    """Return the poses of the runs that have some."""
    folders = [result.case.run.directory for result in own if result.case.run and result.document]
    files = [folder / RUN_POSES for folder in folders if (folder / RUN_POSES).is_file()]
    names = [f"{OWN}-{k}" for k in range(1, len(files) + 1)] if len(files) > 1 else [OWN]
    return [TrajectorySource(name, str(file), LASER) for name, file in zip(names, files, strict=False)]
