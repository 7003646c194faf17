"""JUnit XML: valid by its schema, and read by another's parser as what it says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import junitparser
import pytest
import xmlschema

from mavnav.batch.ci import to_junit

SCHEMA = xmlschema.XMLSchema(Path(__file__).with_name("junit.xsd"))


def read(text: str) -> junitparser.JUnitXml:
    SCHEMA.validate(text)
    return junitparser.JUnitXml.fromstring(text.encode())


def failed_gate(document: dict[str, Any]) -> dict[str, Any]:
    """Let the good run fail a gate."""
    gate = {"gate": "map.rows<=3", "value": 7, "passed": False, "why": "it is 7"}
    document["cells"][2].update(code=1, gates=[gate])
    return document


def test_a_suite_a_log_and_a_case_a_run(document: dict[str, Any]) -> None:
    suites = list(read(to_junit(failed_gate(document))))
    assert [suite.name for suite in suites] == ["logs/cut.mcap", "logs/empty.mcap", "logs/good.mcap", "gone.bag"]
    cases = [case for suite in suites for case in suite]
    assert [type(case.result[0]).__name__ for case in cases] == ["Failure", "Error", "Failure", "Error"]
    assert [case.result[0].message for case in cases][2:] == [
        "gate map.rows<=3 failed: it is 7",
        "gone.bag: no such file; give the path of a log",
    ]
    assert {case.classname for case in cases} == {suite.name for suite in suites}
    assert cases[0].result[0].type == "exit code 3"


def test_figures_are_the_output_of_a_case(document: dict[str, Any]) -> None:
    good = next(iter(list(read(to_junit(document)))[2]))
    assert good.is_passed
    verdict, *lines = good.system_out.splitlines()
    assert verdict == "verdict good: no sign of an error in path or map"
    figures = dict(line.split() for line in lines)
    run = document["cells"][2]["run"]
    assert int(figures["scans.processed"]) == run["scans"]["processed"]
    assert float(figures["wall_thickness.2.p95_mm"]) == pytest.approx(run["wall_thickness"]["2"]["p95_mm"], rel=1e-5)


def test_totals_are_sums(document: dict[str, Any]) -> None:
    whole = read(to_junit(failed_gate(document)))
    assert (whole.tests, whole.failures, whole.errors) == (4, 2, 2)
    assert whole.time == pytest.approx(sum(suite.time for suite in whole), abs=0.002)
    told = (whole.tests, whole.failures, whole.errors)
    whole.update_statistics()
    assert (whole.tests, whole.failures, whole.errors) == told


@pytest.mark.parametrize(("gate", "result"), [(True, "Failure"), (False, "Skipped")])
def test_what_the_baseline_has_and_the_batch_has_not(document: dict[str, Any], gate: bool, result: str) -> None:
    document["baseline"] = {"missing": ["logs/old.bag robust"], "gate": gate}
    whole = read(to_junit(document))
    suite = list(whole)[-1]
    (case,) = suite
    assert (case.name, type(case.result[0]).__name__) == ("logs/old.bag robust", result)
    assert (suite.tests, suite.failures, suite.skipped) == (1, int(gate), int(not gate))
    assert (whole.tests, whole.failures) == (5, 1 + int(gate))


def test_whatever_a_log_is_called_the_file_is_xml(document: dict[str, Any]) -> None:
    document["cells"][3].update(log="a\x00<b>&\ud800", name="a\x00<b>&\ud800 robust", error="\x1b[31m]]>")
    case = next(iter(list(read(to_junit(document)))[-1]))
    assert (case.classname, case.name, case.result[0].message) == ("a?<b>&?", "robust", "?[31m]]>")


def test_a_batch_of_nothing(document: dict[str, Any]) -> None:
    assert list(read(to_junit({**document, "cells": []}))) == []
