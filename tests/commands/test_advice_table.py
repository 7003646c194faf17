"""Every message that names an option, a setting or a command has a trial: a test that causes it and does as it says."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from itertools import chain
from pathlib import Path

import pytest
from typer.main import get_command

from mavnav.cli import app_for
from support.advice_trials import TRIALS

TRIED = {
    "pipelines/test_config_for_log.py": {
        "set robust.max_speed_m_s to choose another limit": "test_that_a_limit_that_is_set_stays"
    },
    "batch/test_cluster.py": {
        "start them with dask worker --memory-limit": "test_a_worker_that_is_started_with_a_limit_keeps_it",
        "if the memory ran out, allow more": "test_a_job_that_is_killed_for_its_memory_ends_where_more_is_allowed",
    },
    "jobs/test_pool.py": {"allow more with --memory-mb": "test_memory_is_limited"},
    "batch/test_batch.py": {
        "add it with --update-baseline and": "test_a_tolerance_for_a_metric_that_the_baseline_lacks_fails_its_gate"
    },
    "commands/test_sources.py": {
        "write mavnav replay - <": "test_a_terminal_is_no_log_but_a_pipe_is",
        "name a log, or pipe one into": "test_a_terminal_is_no_log_but_a_pipe_is",
    },
    "commands/test_advice.py": {
        "see what publishes them, or give the mounting with": "test_a_mounting_that_is_given_takes_the_warning_away",
        "give where the laser mostly is with": "test_a_mounting_that_is_given_takes_the_warning_away",
        "(give the mounting with --extrinsic x,y,yaw)": "test_a_mounting_that_is_given_takes_the_warning_away",
        "check --start and --end": "test_a_window_within_the_time_that_an_error_states_has_scans",
        "compare with it by --truth topic:": "test_an_odometry_topic_that_is_named_can_be_chosen",
        "none is used: {}; choose with --odom TOPIC": "test_an_odometry_topic_that_is_named_can_be_chosen",
        "if they are walls, replay with": "test_the_returns_that_info_names_are_used_or_left_out",
        "set robust.far_mm to choose another limit": "test_returns_beyond_the_default_are_used_where_most_are",
        "mavnav: damage: {} more; --json lists them": "test_damage_that_is_not_printed_is_in_json",
        "has a tracked scan; examine them with mavnav info": "test_logs_without_scans_are_explained_by_info",
        "examine it with mavnav info": "test_logs_without_scans_are_explained_by_info",
        "settings is {}; give a dictionary": "test_settings_of_python_are_a_dictionary_as_the_error_writes_it",
        "replay with --set upside_down=true": "test_mirrored_scans_are_named_where_odometry_turns_the_other_way",
        "more warnings; choose a topic with --topic": "test_warnings_of_many_topics_are_listed_by_topic",
        "check the driver, or cut the log with": "test_scans_that_repeat_are_cut_off",
        "they are not used: record it for the whole log": "test_an_attitude_of_a_part_is_enough_for_that_part",
        "{}: {}, or write --attitude off": "test_an_attitude_that_cannot_be_used_is_left_out_by_off",
    },
    "logs/test_bounds.py": {
        "are left out, name one by --topic": "test_of_hundreds_of_topics_the_first_hundred_are_read"
    },
    "batch/test_pinned.py": {
        "no log of the manifest has this name": "test_names_and_digests_that_cannot_be_meant_are_refused",
        "is no folder; name that of your copies with": "test_a_copy_is_used_by_its_content_whatever_its_name",
        "try again, or give a copy with --copies": "test_other_content_is_refused_and_removed",
    },
    "commands/test_docs_command.py": {
        "'mavnav docs' names the pages": "test_what_there_is_not_is_answered_by_what_there_is",
        "has no section {}; see 'mavnav docs": "test_what_there_is_not_is_answered_by_what_there_is",
        "[bold]Documentation[/bold]  mavnav docs": "test_the_page_that_ends_the_help_of_a_command_is_there",
    },
    "commands/test_view.py": {"no browser could be started; open": "test_a_browser_that_does_not_start_is_named"},
    "logs/test_other_scans.py": {
        "choose the messages to take scans from with --topic": "test_two_such_topics_need_a_choice"
    },
    "commands/test_replay.py": {
        "leave the rest out with --end": "test_a_log_of_which_the_end_is_lost_is_suspect",
        "if it is wrong, correct --start-pose": "test_a_start_pose_far_from_the_pose_found_is_told",
        "compare both maps with mavnav diff": "test_a_run_in_a_given_map_is_compared_with_it_by_diff",
    },
    "commands/test_advice_on_tracks.py": {
        "look at the ranges with mavnav info, and at near_mm": "test_too_few_beams_are_told_by_info",
        "see whether its stamps ascend with mavnav info": "test_a_clock_that_was_set_back_is_explained_by_info",
        "look at the sensor with mavnav info; record": "test_a_blind_log_is_explained_and_drawn_as_the_error_says",
        "of a run with --outputs pictures": "test_a_blind_log_is_explained_and_drawn_as_the_error_says",
        "out of memory; try larger cells, narrower windows": "test_a_map_too_large_fits_in_larger_cells",
        "too large for the memory: a pose or a range is far off": "test_a_map_too_large_fits_in_larger_cells",
        "('mavnav calibrate' compares them)": "test_odometry_of_something_else_is_compared_by_calibrate",
        "the others are matched without it: record it": "test_the_stretch_that_odometry_covers_is_replayed_alone",
        "replay the parts that are left out alone": "test_parts_that_are_left_out_are_replayed_alone",
        "are left out; replay them alone with": "test_parts_that_are_left_out_are_replayed_alone",
        "replay {} alone with --start {} --end {}": "test_parts_that_are_left_out_are_replayed_alone",
        "--start {} --end {}": "test_what_has_poses_of_a_lost_log_is_mapped_alone",
        "use --odom auto if the log has odometry": "test_odometry_that_was_left_out_is_used_as_advised",
        "--attitude TOPIC uses a topic whatever the walls say": "test_a_tilt_that_is_not_used_is_used_by_name",
        "See them with 'mavnav info'": "test_spoilt_scans_are_explained_by_info",
    },
    "logs/test_carmen.py": {"--truth auto compares with them": "test_corrected_poses_are_truth_and_no_odometry"},
    "logs/test_choice.py": {
        "turned over (not with --extrinsic": "test_scans_of_a_laser_upside_down_are_turned_over",
        "used as recorded, as --extrinsic knows": "test_scans_of_a_laser_upside_down_are_turned_over",
    },
    "commands/test_diff.py": {"{} more; --json lists them": "test_changes_that_are_not_printed_are_in_json"},
    "logs/test_attitude.py": {
        "(record /tf_static, or give": "test_a_sensor_that_hardly_tilts_or_whose_mounting_is_unknown_is_not_used"
    },
}
"""File -> part of a message -> the test in it that tries it; those of `TRIALS` have a test of their own."""

DOCUMENTS = ("config/options.py", "documents/run_json.py", "documents/sections.py")
"""Modules whose texts describe options and keys."""

LEAST_WORDS = 4


def names() -> re.Pattern[str]:
    """Return the pattern of what a message may name: an option or a command of mavnav, or a setting of a replay."""
    commands = get_command(app_for([])).commands
    options = {name for command in commands.values() for p in command.params for name in p.opts if name[:2] == "--"}
    return re.compile(
        rf"(?<![\w-])(?:{'|'.join(sorted(options, key=len, reverse=True))})(?![\w-])|mavnav (?:{'|'.join(commands)})\b"
        r"|\b(?:robust|odometry)\.[a-z_]+|\b(?:near|far)_mm\b"
    )


def literals(tree: ast.AST) -> Iterator[str]:
    """Yield the texts of a module, those of f-strings with {} for values, but no documentation and no help."""
    left_out = set()
    for node in ast.walk(tree):
        match node:
            case ast.Expr(ast.Constant() as text):
                left_out.add(id(text))
            case ast.JoinedStr(values=parts):
                left_out |= {id(part) for part in parts if isinstance(part, ast.Constant)}
            case ast.keyword(arg="help" | "epilog" | "metavar") | ast.Assign(targets=[ast.Name(id="EPILOG")]):
                left_out |= {id(each) for each in ast.walk(node)}
            case ast.AnnAssign():
                left_out |= {id(each) for each in ast.walk(node.annotation)}
            case ast.arg(annotation=ast.AST() as annotation):
                left_out |= {id(each) for each in ast.walk(annotation)}
    for node in ast.walk(tree):
        match node:
            case _ if id(node) in left_out:
                continue
            case ast.Constant(str() as text):
                yield text
            case ast.JoinedStr(values=parts):
                yield "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in parts)


@cache
def messages(root: Path) -> list[str]:
    """Return all messages that name something to do."""
    named, texts = names(), set()
    for path in sorted((root / "mavnav").rglob("*.py")):
        if not path.as_posix().endswith(DOCUMENTS):
            texts |= set(literals(ast.parse(path.read_text())))
    return sorted(text for text in texts if named.search(text) and len(text.split()) >= LEAST_WORDS and text[0] != "#")


def is_tried(message: str, part: str) -> bool:
    """Return whether a trial of a part of a message is one of this message."""
    pieces = [piece.strip() for piece in message.split("{}")]
    return part in message or any(piece in part for piece in pieces if len(piece.split()) >= LEAST_WORDS)


def test_every_advice_has_a_trial(repo_root: Path) -> None:
    parts = [*chain(*TRIED.values()), *(message for message, *_ in TRIALS)]
    untried = [message for message in messages(repo_root) if not any(is_tried(message, part) for part in parts)]
    assert not untried, "\n".join(untried)


@pytest.mark.parametrize("file", TRIED)
def test_the_trials_are_those_of_messages(file: str, repo_root: Path) -> None:
    source, all_ = (repo_root / "tests" / file).read_text(), messages(repo_root)
    for part, name in TRIED[file].items():
        assert any(part in message for message in all_), part
        assert f"def {name}(" in source
