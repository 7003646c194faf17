"""Addresses of logs as they may be written: without user names, passwords and query strings."""

from __future__ import annotations

import re
from typing import Final
from urllib.parse import unquote

_SCHEME: Final = r"(?i:[a-z][a-z0-9+.-]+://)"
_ADDRESS: Final = rf"(?i:[a-z][a-z0-9+.-]*::)*{_SCHEME}"
_IN_TEXT: Final = rf"{_SCHEME}[^\s'\"<>]+"
_IN_LINE: Final = r"(?P<scheme>(?i:[a-z][a-z0-9+.-]+)):(?P<slashes>//?)(?P<rest>[^\s'\"<>]*[?#@][^\s'\"<>]*)"
"""Patterns, compiled only for texts that may hold an address: few runs do."""

_LEAST_SECRET: Final = 4
"""Shorter parts of an address stand for other things in a text, too."""


def is_address(text: str) -> bool:
    """Return whether a text is an address (``s3://bucket/drive.mcap``, ``simplecache::s3://...``), not a path."""
    return "://" in text and re.match(_ADDRESS, text) is not None


def public_address(address: str) -> str:
    """Return an address without user name, password, query and, on a web server, fragment; ``a::b`` part by part."""
    return "::".join(_public(part) for part in address.split("::"))


def public_word(word: str) -> str:
    """Return a word of a command line, in which an address may extend from anywhere to the end."""
    begin = re.search(_SCHEME, word) if "://" in word else None
    return word if begin is None else word[: begin.start()] + public_address(word[begin.start() :])


def public_line(text: str) -> str:
    """Return a text for people in which all addresses are public, also those that a path has taken a slash from."""
    return re.sub(_IN_LINE, _public_match, text) if ":/" in text else text


def _public_match(match: re.Match[str]) -> str:
    scheme, slashes, rest = match["scheme"], match["slashes"], match["rest"]
    end = rest[len(rest.rstrip(".,:;)")) :]
    whole = public_address(f"{scheme}://{rest.removesuffix(end)}")
    return f"{scheme}:{slashes}{whole.partition('://')[2]}{end}"


def public_text(text: str, address: str) -> str:
    """Return a text, such as an error of a library, that may hold ``address``, others, or the secrets of it."""
    text = re.sub(_IN_TEXT, lambda match: public_address(match[0]), text.replace(address, public_address(address)))
    for secret in _secrets(address):
        text = text.replace(secret, "***")
    return text


def _public(address: str) -> str:
    scheme, separator, rest = address.partition("://")
    if not separator:
        return address.partition("?")[0]
    rest = rest[len(_user(rest)) :].partition("?")[0]
    return f"{scheme}://{rest.partition('#')[0] if scheme.lower().startswith('http') else rest}"


def _user(rest: str) -> str:
    """Return user name and password, with the ``@`` behind them, of what follows the scheme.

    A password may hold characters that end the host; what stands for a port then is no number.
    """
    host = re.split(r"[/?#]", rest, maxsplit=1)[0]
    if "@" not in host:
        port = host.rpartition(":")[2] if ":" in host and not host.endswith("]") else ""
        host = rest if port and not port.isdecimal() else ""
    return host[: host.rfind("@") + 1]


def _secrets(address: str) -> list[str]:
    """Return what `public_address` leaves out, whole and in its parts, the longest first."""
    secrets: set[str] = set()
    for part in address.split("::"):
        _, _, rest = part.partition("://")
        user, query = _user(rest).removesuffix("@"), rest.partition("?")[2]
        values = [field.partition("=")[2] for field in re.split("[&#]", query)]
        secrets |= {user, query, *user.split(":", 1), *values}
    secrets |= {unquote(secret) for secret in secrets}
    return sorted((secret for secret in secrets if len(secret) >= _LEAST_SECRET), key=len, reverse=True)
