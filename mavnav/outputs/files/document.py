"""The documents that machines read: run.json and metrics.json."""

from __future__ import annotations

import json
import platform
from collections.abc import Collection, Sequence
from math import hypot, isfinite
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import astuple, replace
from numpy.typing import NDArray

from mavnav.config.models import Config, OdometryConfig
from mavnav.logs import Log
from mavnav.logs.records import Odometry
from mavnav.metrics.fields import ABSENT
from mavnav.outputs.documents import run_json as model
from mavnav.outputs.documents import sections
from mavnav.outputs.documents.addresses import public_address
from mavnav.outputs.documents.provenance import versions
from mavnav.outputs.documents.verdict import Verdict, verdict_of
from mavnav.outputs.files.gridmap import map_section
from mavnav.outputs.run import RunResult, base_frame, half_sweep_s
from mavnav.profiling import peak_memory_mb
from mavnav.slam.findings import Doubt, Reason
from mavnav.slam.matching.odometry_fit import GOOD_ODOMETRY, OdometryFit
from mavnav.slam.matching.steps import LostInterval, Steps, refused_by
from mavnav.slam.recovery.parts import Part
from mavnav.slam.result import SlamResult
from mavnav.units import DEG, NS
from mavnav.version import DOCUMENT_HEAD

FAR_FROM_START_M: Final = 3.0
"""Distance of the pose found from the given start pose above which a run warns; the search near that ends at 1 m."""

MAP_PICTURE: Final = "map.png"
OTHER_PICTURE: Final = f"{MAP_PICTURE} of a run with --outputs pictures"


def run_document(run: RunResult, outputs: dict[str, str]) -> model.RunDocument:
    """Describe a run; ``outputs`` maps the files written to their SHA-256."""
    mission, at = run.mission, run.slam.map_T_begin
    return model.RunDocument(
        **DOCUMENT_HEAD,
        verdict=run_verdict(run),
        python=platform.python_version(),
        libraries=versions(),
        input=_input(run),
        config=run.config,
        method=run.method,
        grid=str(run.config.grid),
        azimuth=run.config.azimuth,
        scenario=mission.scenario if mission else ABSENT,
        scans=_scans(run.slam, run.log, run.config),
        cleaning=dict(run.log.cleaning),
        tracking=_tracking(run.slam, run.log, run.config),
        loop_closure=_loop_closure(run),
        localisation=run.localisation or ABSENT,
        alignment=model.StartPose(at.x_m, at.y_m, at.yaw_rad / DEG) if at else ABSENT,
        external=run.external or ABSENT,
        continued=run.continued or ABSENT,
        search=_search(run.slam),
        wall_thickness=run.walls if run.metrics else ABSENT,
        map_quality=run.metrics.quality if run.metrics else ABSENT,
        reference=run.reference or ABSENT,
        map=map_section(run.known, run.slam.tracked_share) if run.metrics else ABSENT,
        slices=[sections.map_slice(layer) for layer in run.slices.layers] if run.slices else ABSENT,
        mission=mission.result if mission else ABSENT,
        truth=mission.errors if mission else ABSENT,
        timing=_timing(run),
        provenance=run.provenance,
        damage=list(run.log.damage),
        warnings=[*_start_warnings(run), *run.slam.warnings, *run.log.warnings],
        outputs=outputs,
        partial=run.stopped is not None,
        exit_code=int(run.exit_code),
    )


def document_without_cost(run: RunResult) -> model.RunDocument:
    """Return run.json without what another program took, for files that are the same each time."""
    document = run_document(run, {})
    if not run.external:
        return document
    return replace(document, external=replace(run.external, wall_s=ABSENT, cpu_s=ABSENT, peak_memory_mb=ABSENT))


def run_verdict(run: RunResult) -> Verdict:
    """Judge a run by the sections of its run.json."""
    return track_verdict(
        run.slam,
        run.log,
        run.config,
        map_quality=run.metrics and run.metrics.quality,
        localisation=run.localisation,
        continued=run.continued,
        method=run.method,
        external=run.external,
        partial=run.stopped is not None,
        mission=run.mission is not None,
    )


def track_verdict(slam: SlamResult, log: Log, config: Config, **more: object) -> Verdict:
    """Judge a track; ``more`` are further sections of a run.json."""
    sections = {
        "method": config.method,
        "config": config,
        "input": {"duration_s": log.duration_s, "start_s": log.start_s, "odometry": log.odometry is not None},
        "scans": _scans(slam, log, config),
        "cleaning": log.cleaning,
        "tracking": _tracking(slam, log, config),
        "search": _search(slam),
    }
    return verdict_of(plain(sections | more))


def write_metrics(run: RunResult, path: Path) -> None:
    """Write metrics.json: other tracks of the log are no metric of this one."""
    document = document_without_cost(run)
    document = replace(document, tracking=replace(document.tracking, attempts=ABSENT))
    path.write_text(to_json({name: getattr(document, name) for name in model.METRICS}), encoding="utf-8")


def to_json(document: object) -> str:
    """Write as JSON; numbers that JSON has no word for (NaN, infinities) become null."""
    return plain_json(plain(document))


def plain_json(document: dict[str, Any]) -> str:
    """Write what `plain` returned as JSON."""
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def plain(value: Any) -> Any:  # noqa: ANN401  any JSON value
    """Bring records, numpy's numbers and numbers that JSON lacks to plain ones; what is absent is left out."""
    if isinstance(value, Config):
        return value.document()
    if isinstance(value, Struct):
        return plain(dict(zip(value.__struct_encode_fields__, astuple(value), strict=True)))
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items() if v is not ABSENT}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value + 0.0 if isfinite(value) else None  # -0.0 becomes 0.0
    return value


def _start_warnings(run: RunResult) -> list[str]:
    """Return the line for the user where the laser was found far from the given start pose."""
    given, pose = (run.localisation.start_pose, run.localisation.found) if run.localisation else (None, None)
    if given is None or pose is None:
        return []
    distance_m = hypot(pose.x_m - given.x_m, pose.y_m - given.y_m)
    place = f"at x {pose.x_m:z.2f} m, y {pose.y_m:z.2f} m (scan {pose.scan}); check the pose found"
    text = f"the laser was found {distance_m:.1f} m from --start-pose, {place}; if it is wrong, correct --start-pose"
    return [text] if distance_m > FAR_FROM_START_M else []


def with_picture(text: str, outputs: Collection[str]) -> str:
    """Return advice to look at ``map.png``; if it is not among the files of the run, with how to get it."""
    return text if MAP_PICTURE in outputs else text.replace(MAP_PICTURE, OTHER_PICTURE)


def _input(run: RunResult) -> model.LogInput:
    log, odometry, mounting, spec = run.log, run.log.odometry, run.log.base_T_laser, run.log.sensor
    source = run.mission or log  # what the user named
    rate_hz = 1.0 / log.period_s if log.period_s else np.nan
    return model.LogInput(
        path=public_address(run.address) if run.address else str(source.path),
        sha256=source.sha256,
        size_bytes=source.size_bytes,
        format="scenario" if run.mission else log.format,
        topic=log.topic,
        frame_id=log.frame_id,
        stamp_source=log.stamp_source,
        first_stamp_s=log.first_ns * NS,
        duration_s=log.duration_s,
        base_frame=log.base_frame,
        base_T_laser=None if mounting is None else model.LaserPose(*mounting),
        mounting_source=log.mounting_source,
        odometry=None if odometry is None else model.OdometrySource(odometry.topic, odometry.source),
        sensor=model.Sensor(spec.beams, spec.field_of_view_rad / DEG, spec.range_min_m, spec.range_max_m, rate_hz),
        start_s=log.start_s or ABSENT,
        truth=ABSENT if log.truth is None else model.RecordedTruthSource(log.truth.topic, log.truth.body_frame),
        attitude=ABSENT if log.attitude is None else sections.attitude_source(log.attitude),
        imu=ABSENT if log.imu is None else model.ImuSource(log.imu.topic, len(log.imu.rotation.stamps_ns)),
        parts=[*map(str, log.more)] if log.more else ABSENT,
    )


def _scans(slam: SlamResult, log: Log, config: Config) -> model.Scans:
    steps, counts, tracked = slam.steps, log.counts, len(slam.trajectory)
    return model.Scans(
        total=counts.total,
        usable=counts.usable,
        processed=len(steps),
        tracked=tracked,
        accepted=tracked,
        rejected=len(steps) - tracked,
        skipped=dict(counts.skipped),
        suspect=counts.suspect,
        refused=_refusals(steps) if config.method == "paper" else ABSENT,
    )


def _refusals(steps: Steps) -> list[model.Refusals]:
    """Sum up which rules of the paper's method refused scans."""
    rules, cost = refused_by(steps), steps.column("cost_m2") / steps.column("threshold_m2")
    values: dict[model.Rule, NDArray[Any]] = {
        "cost": -cost,
        "share": steps.column("inliers"),
        "beams": steps.column("beams_used"),
    }
    of_rule = ((rule, value[rules == rule]) for rule, value in values.items() if (rules == rule).any())
    return [model.Refusals(rule, len(v), abs(float(np.median(v))), abs(float(v.min()))) for rule, v in of_rule]


def _tracking(slam: SlamResult, log: Log, config: Config) -> sections.Tracking:
    first_ns = log.first_ns
    return sections.Tracking(
        lost=slam.lost_for_good,
        intervals=[sections.Interval(*_span_s(lost, first_ns), lost.scans, lost.recovered) for lost in slam.lost],
        tracked_share=slam.tracked_share,
        opinions=slam.tracks_compared,
        path_length_m=slam.trajectory.travelled_m,
        doubt=_doubt(slam.doubt, first_ns),
        frames={"trajectory.tum": ["map", log.frame_id]}
        | ({} if log.base_T_laser is None else {"trajectory_base.tum": ["map", base_frame(log)]}),
        holds_s=round(half_sweep_s(log, slam), 6),
        parts=[sections.TrackedPart(*_span_s(p, first_ns), p.scans, p.joined) for p in slam.parts] or ABSENT,
        attempts=[sections.OtherTrack(*attempt) for attempt in slam.attempts] or ABSENT,
        odometry=_odometry_use(log.odometry, slam.odometry, config.odometry) if log.odometry else ABSENT,
    )


def _odometry_use(odometry: Odometry, fit: OdometryFit | None, given: OdometryConfig) -> sections.OdometryUse:
    """Describe how odometry was used: what corrects it includes what the configuration ``given`` corrects."""
    best, left_out = fit or GOOD_ODOMETRY, odometry.left_out
    known = fit is not None and 0.0 < fit.error < np.inf
    return sections.OdometryUse(
        fit is not None,
        round((given.offset_s or odometry.clock_s) + best.offset_s, 3),
        given.distance_scale * best.distance_scale,
        given.turn_scale * best.turn_scale,
        sections.OdometryNoise(*((best.noise_m_per_m, best.noise_rad_per_rad) if known else (np.nan, np.nan))),
        [sections.OdometryLeftOut(left_out.jumps, left_out.poses, left_out.since_s)] if left_out else [],
    )


def _span_s(part: LostInterval | Part | Reason, first_ns: int) -> tuple[float, float]:
    """Return start and end of a part of a track, s from the first scan."""
    return (part.start_ns - first_ns) * NS, (part.end_ns - first_ns) * NS


def _doubt(doubt: Doubt | None, first_ns: int) -> sections.DoubtSection:
    if doubt is None:
        return sections.DoubtSection(np.nan, [], [])
    reasons = [sections.DoubtReason(r.name, *_span_s(r, first_ns), r.value) for r in doubt.reasons]
    return sections.DoubtSection(doubt.probability, reasons, list(doubt.tried))


def _loop_closure(run: RunResult) -> model.LoopClosure:
    slam, first_ns = run.slam, run.log.first_ns
    scans = slam.steps.column("index")[slam.steps.column("tracked")].tolist()
    stamps_ns = slam.trajectory.stamps_ns
    return model.LoopClosure(
        closures=[
            model.ClosedLoop(
                from_scan=scans[loop.start],
                to_scan=scans[loop.end],
                from_s=(int(stamps_ns[loop.start]) - first_ns) * NS,
                to_s=(int(stamps_ns[loop.end]) - first_ns) * NS,
                correction_m=loop.correction.distance_m,
                correction_deg=loop.correction.yaw_rad / DEG,
                inliers=loop.inliers,
            )
            for loop in slam.loops.closed
        ],
        rejected=slam.loops.refused,
        corrected=slam.loops.map_T_laser is not None,
    )


def _search(slam: SlamResult) -> model.Search:
    steps = slam.steps
    costs_m2 = steps.column("cost_m2")
    return model.Search(
        evaluations_per_scan=_spread(steps.column("evaluations")),
        iterations_per_scan=_spread(steps.column("iterations")),
        converged_share=steps.share("converged"),
        cost_m2=_spread(costs_m2[np.isfinite(costs_m2)]),
        beams_used=_spread(steps.column("beams_used")),
        inliers=_spread(steps.column("inliers")),
    )


def _spread(values: NDArray[Any]) -> model.Spread:
    if not len(values):
        return model.Spread(np.nan, np.nan, np.nan, np.nan)
    return model.Spread(float(np.mean(values)), float(np.median(values)), values.min().item(), values.max().item())


def _timing(run: RunResult) -> model.TimingReport:
    t, scans = run.timing, len(run.slam.steps)
    work_s = max(t.wall_s, 1e-9)
    return model.TimingReport(
        wall_s=t.wall_s,
        cpu_s=t.cpu_s,
        compile_s=t.compile_s,
        stages=dict(t.stages),
        scans_per_s=scans / work_s,
        realtime_factor=run.log.duration_s / work_s,
        scan=_scan_time(t.scans_s, run.log.period_s) if t.scans_s else ABSENT,
        peak_memory_mb=peak_memory_mb(),
    )


def _scan_time(scans_s: Sequence[float], period_s: float) -> model.ScanTime:
    median, p95, most = (1e3 * np.quantile(scans_s, (0.5, 0.95, 1.0))).tolist()
    return model.ScanTime(median, p95, most, 1e3 * period_s or np.nan)
