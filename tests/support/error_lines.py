"""What a command leaves that ends with an error: a code, and one line on stderr."""

from __future__ import annotations


def expect_error(result: tuple[int, str, str], code: int, *words: str) -> None:
    """Check exit code, stdout (empty) and stderr (one line with the words) of a command."""
    got, out, err = result
    assert got == code, err
    assert out == ""
    assert err.startswith("mavnav: error: ")
    assert err.count("\n") == 1, err
    for word in words:
        assert word in err
