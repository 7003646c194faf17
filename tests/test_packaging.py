"""What ships beside the program: version, citation, GitHub action, pre-commit hook, container image."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
import yaml

from mavnav import __version__
from mavnav.cli import LIBRARIES, run
from mavnav.outputs.documents import provenance
from mavnav.version import installed_version

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_version_is_the_same_everywhere() -> None:
    released = re.findall(r"^## \[(\d.*?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert released[0] == __version__
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert (citation["title"], citation["version"]) == (PROJECT["name"], __version__)
    assert [author["name"] for author in citation["authors"]] == [author["name"] for author in PROJECT["authors"]]


@pytest.mark.parametrize("name", sorted({*LIBRARIES, *provenance.LIBRARIES}))
def test_the_folder_of_a_library_has_its_version(name: str) -> None:
    try:
        wanted = metadata.version(name)
    except metadata.PackageNotFoundError:
        wanted = "none"
    assert installed_version(name) == wanted


def test_the_text_of_the_package_index_needs_no_other_file() -> None:
    code = re.search(r"^def index_text.*?\n\n\n", (ROOT / "hatch_build.py").read_text(), re.MULTILINE | re.DOTALL)
    assert code
    names: dict[str, Any] = {"re": re}
    exec(code[0], names)  # without hatchling, which only a build has
    text = names["index_text"]((ROOT / "README.md").read_text())
    assert "Every command has `--help` with examples; docs/cli.md has the details." in text
    assert re.findall(r"!\[|\]\((?!https://)", text) == []


@pytest.fixture
def stub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a command ``mavnav`` first that writes its words, one a line, and fails for bad.bag."""
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "mavnav").write_text('#!/bin/sh\nprintf "%s\\n" "$@" >> words\ncase "$*" in *bad.bag*) exit 3;; esac\n')
    (folder / "mavnav").chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "words"


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_the_github_action_hands_its_inputs_on_as_they_are(stub: Path) -> None:
    action = yaml.safe_load((ROOT / "action.yml").read_text())
    step = action["runs"]["steps"][-1]
    given = {"sources": "logs/**/*.mcap\n$(touch x).bag\n", "gates": "map.accepted_share>=0.95", "options": "--online"}
    inputs = {name: text.get("default", "") for name, text in action["inputs"].items()} | given
    env = {name: inputs[re.fullmatch(r"\$\{\{ inputs\.(\S+) \}\}", text)[1]] for name, text in step["env"].items()}  # type: ignore[index]
    subprocess.run(["bash", "-e", "-c", step["run"]], env=os.environ | env, check=True)
    assert stub.read_text().split("\n")[:-1] == [
        *["batch", "--gate", "map.accepted_share>=0.95", "--online"],
        *["--output", "runs/batch", "--junit", "runs/batch.xml", "--", "logs/**/*.mcap", "$(touch x).bag"],
    ]
    assert not (stub.parent / "x").exists()


def workflow(name: str) -> dict[str, Any]:
    return yaml.safe_load((ROOT / f".github/workflows/{name}.yml").read_text())["jobs"]


def test_the_workflows_run_every_python_that_is_promised() -> None:
    promised = {text.rpartition(" ")[2] for text in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", text)}
    for job in (workflow("test")["test"], workflow("release")["install"]):
        matrix = job["strategy"]["matrix"]
        assert promised <= set(matrix["python"])
        assert [os.partition("-")[0] for os in matrix["os"]] == ["ubuntu", "macos", "windows"]
    publish = workflow("release")["publish"]
    assert (publish["needs"], publish["permissions"]) == (["test", "install"], {"id-token": "write"})
    assert not any("password" in step.get("with", {}) for step in publish["steps"])


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(("tag", "code"), [(f"v{__version__}", 0), ("v9.9.9", 1), (f"v{__version__}0", 1), (".*", 1)])
def test_a_release_refuses_a_tag_of_another_version(tag: str, code: int) -> None:
    (step,) = (each for each in workflow("release")["build"]["steps"] if "TAG" in each.get("env", {}))
    env = os.environ | {"TAG": tag}
    assert subprocess.run(["bash", "-e", "-c", step["run"]], env=env, cwd=ROOT, check=False).returncode == code


def test_the_pre_commit_hook_examines_every_log(stub: Path) -> None:
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
    done = subprocess.run([*shlex.split(hook["entry"]), "a b.mcap", "bad.bag", "c.bag"], check=False)
    assert done.returncode == 3
    words = stub.read_text().splitlines()
    assert words == [word for log in ("a b.mcap", "bad.bag", "c.bag") for word in ("info", "--strict", "--quiet", log)]
    assert all(re.search(hook["files"], name) for name in ("a.mcap", "b.bag.gz", "c/d.db3"))


def test_info_has_the_options_of_the_hook(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", "--strict", "--quiet", str(ROOT / "sample_logs/complex.bag")]) == 0


def test_the_image_has_what_it_copies() -> None:
    text = (ROOT / "Dockerfile").read_text()
    ignored = (ROOT / ".dockerignore").read_text().split()
    needed = ["pyproject.toml", "README.md", "mavnav", "configs", *PROJECT["license-files"]]
    assert not {Path(name).parts[0] for name in needed} & set(ignored)
    assert "RUN mavnav warmup" in text
