"""Addresses as they may be written: user names, passwords and queries never appear."""

from __future__ import annotations

import pytest

from mavnav.outputs.documents.addresses import public_address, public_line, public_text, public_word

SECRETS = ("alice", "hunter2", "sig=", "token", "SECRET")


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("s3://drives/day 1/good.mcap", "s3://drives/day 1/good.mcap"),
        ("file:///logs/a#1.mcap", "file:///logs/a#1.mcap"),
        ("http://[::1]:8000/a.mcap", "http://[::1]:8000/a.mcap"),
        ("https://host/@team/a.mcap", "https://host/@team/a.mcap"),
        ("https://host:8443/a.mcap?sig=SECRET&x=1", "https://host:8443/a.mcap"),
        ("https://alice:hunter2@host:8443/a.mcap", "https://host:8443/a.mcap"),
        ("ftp://alice@host/a.mcap", "ftp://host/a.mcap"),
        ("https://alice:hunt/hunter2@host/a.mcap?sig=SECRET", "https://host/a.mcap"),
        ("https://alice:hunt?hunter2@host/a.mcap", "https://host/a.mcap"),
        ("https://alice:hunter2#x@host/a.mcap", "https://host/a.mcap"),
        ("https://alice:a@hunter2@host/a.mcap", "https://host/a.mcap"),
        ("https://host/a.mcap#access_token=SECRET", "https://host/a.mcap"),
        ("zip://a.mcap::https://alice:hunter2@host/a.zip?sig=SECRET", "zip://a.mcap::https://host/a.zip"),
    ],
)
def test_what_is_left_of_an_address(address: str, shown: str) -> None:
    assert public_address(address) == shown
    assert public_word(f"--log={address}") == f"--log={shown}"
    error = public_text(f"cannot GET {address} ('{address}')", address)
    assert not any(secret in error for secret in SECRETS)


def test_words_without_an_address_stay() -> None:
    for word in ("drive.mcap", "a?b.mcap", "--set=robust.cell_mm=25", "me@host", "*.mcap"):
        assert public_word(word) == word


def test_secrets_are_found_in_other_spellings() -> None:
    address = "https://alice:hunter%322@host/a.mcap?sig=SECRET%2Bx"
    text = public_text("403 for sig SECRET+x of alice with hunter22 at https://host/a.mcap?other=1", address)
    assert text == "403 for sig *** of *** with *** at https://host/a.mcap"


@pytest.mark.parametrize("slashes", ["/", "//"])
def test_a_line_for_people_has_no_secrets(slashes: str) -> None:
    text = public_line(f"https:{slashes}alice:hunter2@host/a.mcap?sig=SECRET: no such file; see 'x:{slashes}y@z'")
    assert text == f"https:{slashes}host/a.mcap: no such file; see 'x:{slashes}y@z'"
    for same in ("topic:/scan, 3 m", "C:/a@b", "me@host", "s3://bucket/a.mcap: no", "mavnav: error: /tmp/a?b"):
        assert public_line(same) == same
