"""``mavnav view``: which page is drawn, where it goes, and who may read it."""

from __future__ import annotations

import json
import os
import shutil
import signal
import urllib.error
import urllib.request
import webbrowser

import pytest

from mavnav.outputs.report.page import finished_page


@pytest.fixture(scope="module")
def finished_run(comparison):
    return next(path.parent for path in sorted(comparison.glob("cells/*/run.json")))


def test_a_run_is_shown(mavnav, finished_run, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    run = tmp_path / "a run"
    shutil.copytree(finished_run, run)
    code, out, err = mavnav("view", run, "-q")
    assert (code, out, err) == (0, f"{run}/report.html\n", "")
    assert opened == [(run / "report.html").as_uri()]
    assert (run / "report.html").read_text() == finished_page(run)[1]


def test_without_a_browser_the_path_is_printed(mavnav, finished_run, tmp_path, monkeypatch):
    monkeypatch.setattr(webbrowser, "open", lambda _: pytest.fail("opened"))
    page = tmp_path / "page.html"
    assert mavnav("view", finished_run, "-q", "--no-browser", "-o", page) == (0, f"{page}\n", "")
    assert 'id="view-data"' in page.read_text()


def test_a_browser_that_does_not_start_is_named(mavnav, finished_run, tmp_path, monkeypatch):
    monkeypatch.setattr(webbrowser, "open", lambda _: False)
    code, _, err = mavnav("view", finished_run, "-q", "-o", tmp_path / "page.html")
    assert code == 0 and "no browser could be started" in err and "--serve" in err


def test_a_run_that_cannot_be_written_is_shown_by_the_page_it_has(mavnav, finished_run, tmp_path, monkeypatch):
    run, (page, other) = tmp_path / "run", (tmp_path / name for name in ("run/report.html", "other.html"))
    shutil.copytree(finished_run, run)
    monkeypatch.setattr(os, "access", lambda path, _: path != run)
    page.unlink(missing_ok=True)
    code, _, err = mavnav("view", run, "-q", "--no-browser")
    assert (code, "run is not writable; name another place for the page with -o" in err) == (6, True)
    assert mavnav("view", run, "-q", "--no-browser", "-o", other)[0] == 0
    page.write_text("as it is")
    assert mavnav("view", run, "-q", "--no-browser")[:2] == (0, f"{page}\n")
    assert page.read_text() == "as it is"


def test_a_page_is_not_replaced_by_one_without_a_run(mavnav, comparison, finished_run, tmp_path):
    run, several = tmp_path / "run", tmp_path / "several"
    shutil.copytree(finished_run, run)
    shutil.copytree(comparison, several)
    (run / "hits.npz").unlink()
    shutil.rmtree(several / "cells")
    for directory in (run, several):
        (directory / "report.html").write_text("as it is")
        code, out, err = mavnav("view", directory, "-q", "--no-browser")
        assert (code, out) == (2, "") and f"{directory} cannot be shown: " in err
        assert (directory / "report.html").read_text() == "as it is"
    assert "it has no hits.npz" in mavnav("view", run, "-q", "--no-browser")[2]


def test_a_run_of_an_earlier_version_without_a_verdict_is_shown(mavnav, finished_run, tmp_path):
    run = shutil.copytree(finished_run, tmp_path / "run")
    document = json.loads((run / "run.json").read_text())
    del document["verdict"]
    (run / "run.json").write_text(json.dumps(document))
    assert mavnav("view", run, "-q", "--no-browser")[0] == 0


def test_what_holds_no_result_is_refused(mavnav, tmp_path):
    code, _, err = mavnav("view", tmp_path, "-q")
    assert code == 2 and f"{tmp_path} holds no run, comparison, batch or merge" in err
    (tmp_path / "run.json").write_text("[]")
    code, _, err = mavnav("view", tmp_path, "-q", "--no-browser")
    assert code == 2 and "run.json lacks what is needed" in err
    assert list(tmp_path.iterdir()) == [tmp_path / "run.json"]


@pytest.mark.slow
def test_the_page_is_served_to_who_knows_its_address_until_ctrl_c(spawn, finished_run):
    before = {path: path.stat().st_mtime_ns for path in finished_run.iterdir()}
    process = spawn("view", finished_run, "--serve", "-q")
    try:
        address = process.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address) as answer:
            assert answer.read().decode() == finished_page(finished_run)[1]
            assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
        base = address.rsplit("/", 2)[0]
        for wrong in (f"{base}/", f"{base}/run.json", f"{address}../run.json", f"{address}run.json", address[:-2]):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(wrong)
        with pytest.raises(urllib.error.HTTPError, match="501"):
            urllib.request.urlopen(urllib.request.Request(address, data=b"x", method="POST"))
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 0
    finally:
        process.kill()
        process.communicate()
    assert before == {path: path.stat().st_mtime_ns for path in finished_run.iterdir()}
