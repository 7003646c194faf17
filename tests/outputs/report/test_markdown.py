"""Names of logs in Markdown are text: no marks, no links, nobody is called."""

from __future__ import annotations

import pytest

from mavnav.outputs.report.markdown import escape


@pytest.mark.parametrize("name", ["@everyone.mcap", "a @org/team b", "https://example.org/x", "x\\n@me"])
def test_nobody_is_called_and_nothing_is_linked(name: str) -> None:
    assert "@everyone" not in escape(name)
    assert not any(f"@{word}" in escape(name) for word in ("everyone", "org", "me"))
    assert "://" not in escape(name)


def test_marks_and_line_ends_are_text() -> None:
    assert escape("a|b*\n") == r"a\|b\*?"
