"""The line on date, log and sensor that every page shows."""

from __future__ import annotations

from jinja2 import Environment

from mavnav.outputs.files.document import plain, run_document
from mavnav.outputs.report.html import environment, facts


def test_date_length_and_sensor(run) -> None:
    document = plain(run_document(run, {}))
    spec = run.log.sensor
    beams = f"{spec.beams} beams, {document['input']['sensor']['field_of_view_deg']:.4g} deg"
    reach = f"from {spec.range_min_m:.3g} m to {spec.range_max_m:.3g} m"
    length = f"log of {document['input']['duration_s']:.1f} s"
    assert facts([document]) == f"2026-01-31 12:00 UTC \u00b7 {length} \u00b7 {beams}, {reach}, 10 Hz, frame /laser"


def made(started: str) -> dict:
    return {"provenance": {"started": started}}


def test_runs_of_several_times() -> None:
    early, late, next_day = (made(f"2026-01-{time}:00Z") for time in ("30T09:05", "30T17:00", "31T01:00"))
    assert facts([early, early]) == "2026-01-30 09:05 UTC"
    assert facts([early, late]) == "2026-01-30"
    assert facts([next_day, early]) == "2026-01-30 to 2026-01-31"


def test_what_is_not_known_is_left_out() -> None:
    assert facts([]) == facts([{}]) == facts([{"input": {"path": "a"}}]) == ""
    sensor = {"beams": 3, "field_of_view_deg": 90.0, "range_min_m": None, "range_max_m": None, "rate_hz": None}
    assert facts([{"input": {"sensor": sensor, "frame_id": ""}}]) == "3 beams, 90 deg, from 0 m"


def test_templates_are_compiled_once_and_never_run_altered(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("MAVNAV_CACHE_DIR", str(tmp_path))
    compiled, compile_template = [], Environment.compile
    monkeypatch.setattr(Environment, "compile", lambda *args: compiled.append(args[2]) or compile_template(*args))

    def times_compiled() -> int:
        environment("mavnav.outputs.report").get_template("page.html")
        return len(compiled)

    assert [times_compiled() for _ in range(3)] == [1, 1, 1]
    (entry,) = tmp_path.rglob("page_*")
    entry.write_bytes(entry.read_bytes()[:-1])
    assert [times_compiled() for _ in range(2)] == [2, 2]
    entry.chmod(0o666)  # anybody could have written it
    assert times_compiled() == 3
