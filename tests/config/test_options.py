"""The record of options, and what follows from it."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest

import mavnav
from mavnav.config.layers import by_dotted_key
from mavnav.config.loading import RESOLUTION
from mavnav.config.models import Config
from mavnav.config.options import (
    OPTIONS,
    READING,
    REFERENCES,
    read_options,
    reference_files,
    restore_options,
    settings_of,
    words_of,
)
from mavnav.errors import UsageError

TYPED: dict[str, object] = {
    "topic": ["/a", "/b"],
    "start_s": 0.0,
    "extrinsic": "0.1,0,1.5",
    "strict": True,
    "map": Path("office.yaml"),
    "truth": "topic:/truth",
    "relations": Path("relations.txt"),
    "deskew": "off",
    "online": True,
    "odom": None,
    "grid": None,
}


def test_what_is_typed_is_read_and_written_as_words() -> None:
    options = read_options(TYPED)
    assert settings_of(options) == {"robust.deskew": "off", "final_pass": False}
    assert words_of(options) == [
        "--topic=/a,/b",
        "--start=0.0",
        "--extrinsic=0.1,0.0,1.5",
        "--strict",
        f"--map={Path.cwd() / 'office.yaml'}",
        "--truth=topic:/truth",
        f"--relations={Path.cwd() / 'relations.txt'}",
    ]


def test_a_document_gives_the_options_back() -> None:
    document = {"topic": None, "end_s": 2.0, "strict": False, "start_pose": {"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.5}}
    truths = {"truth": "a.tum", "truth_map": "map.yaml", "unknown": 1}
    options = restore_options(document | truths, lambda text: Path("night") / text)
    assert options == {
        "end_s": 2.0,
        "start_pose": (1.0, 2.0, 0.5),
        "truth": Path("night/a.tum"),
        "truth_map": Path("night/map.yaml"),
    }
    assert reference_files(options) == {"truth": Path("night/a.tum"), "truth_map": Path("night/map.yaml")}
    assert restore_options({"truth": "auto"}, Path) == {"truth": "auto"}


def test_a_pose_that_cannot_be_meant_is_refused_by_its_option() -> None:
    with pytest.raises(UsageError, match="--start-pose '1,2' is not X,Y,YAW"):
        read_options({"start_pose": "1,2"})


@pytest.mark.parametrize(("typed", "value"), [("walls", "walls"), ("none", "none"), ("1,-2, 1.57", "1.0,-2.0,1.57")])
def test_a_map_is_aligned_by_a_word_or_a_pose(typed: str, value: str) -> None:
    options = read_options({"align": typed})
    assert options.get("align") == value
    assert words_of(options) == [f"--align={value}"]
    assert restore_options(dict(options), Path) == options


@pytest.mark.parametrize(
    ("typed", "problem"),
    [(text, "is neither walls, none nor X,Y,YAW in m, m, rad") for text in ("wall", "", "1,2", "1,2,3,4")]
    + [("1,2,nan", "not finite"), ("1e9,0,0", "from the origin"), ("0,0,90", "give it in rad, for 90 deg 1.5708")],
)
def test_an_alignment_that_cannot_be_is_refused(typed: str, problem: str) -> None:
    with pytest.raises(UsageError, match=f"--align '{typed}' .*{problem}"):
        read_options({"align": typed})


def test_names_are_those_of_options() -> None:
    assert {*READING, *REFERENCES} <= OPTIONS.keys()
    settings = {option.setting: option for option in OPTIONS.values() if option.setting}
    assert settings.keys() - {RESOLUTION} <= by_dotted_key(Config().document()).keys()
    assert not any(option.manifest for option in settings.values())


@pytest.mark.parametrize("function", [mavnav.replay, mavnav.simulate, mavnav.track])
def test_python_shows_the_options(function) -> None:  # type: ignore[no-untyped-def]
    parameters = inspect.signature(function).parameters
    names = OPTIONS if function is mavnav.replay else ("method", "grid", "azimuth")
    assert all(parameters[name].kind is inspect.Parameter.KEYWORD_ONLY for name in names)
    assert inspect.Parameter.VAR_KEYWORD not in {each.kind for each in parameters.values()}
    documented = inspect.getdoc(function).partition("Parameters\n")[2]
    for name in names:
        assert f"\n{name}\n" in documented
    assert "**options" not in documented
    assert function.__annotations__["return"] in {"Run", "Iterator[Step]"}


def test_python_refuses_options_that_a_function_does_not_have() -> None:
    with pytest.raises(TypeError, match="no argument topik; did you mean topic"):
        mavnav.replay("a.mcap", topik="/scan")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="no argument b;"):  # the first of them
        mavnav.replay("a.mcap", **dict.fromkeys("badcef"))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="simulate has no argument topic"):
        mavnav.simulate("corner", topic="/scan")  # type: ignore[call-arg]
