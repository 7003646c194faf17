"""The client of web servers: time limits, and no redirection into private networks that the user did not name."""

from __future__ import annotations

import socket
from contextlib import suppress
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import aiohttp

from mavnav.errors import UsageError
from mavnav.outputs.documents.addresses import public_address

if TYPE_CHECKING:
    from collections.abc import Callable


def client_options(address: str, total_s: float, idle_s: float, *, private: bool) -> dict[str, Any]:
    """Return the options of ``fsspec.open`` for an address with ``http(s)://`` in it.

    A request may take ``total_s`` in all and ``idle_s`` without data. A host of a private network is allowed only with
    ``private`` and if the address itself names it; a redirection to another one raises UsageError.
    """
    parts = [part for part in address.split("::") if part.lower().startswith(("http://", "https://"))]
    timeout = aiohttp.ClientTimeout(total=total_s, sock_connect=idle_s, sock_read=idle_s)
    make_socket = _socket_factory(parts, private=private)

    async def get_client(**options: Any) -> aiohttp.ClientSession:  # noqa: ANN401
        connector = aiohttp.TCPConnector(socket_factory=make_socket)
        return aiohttp.ClientSession(**{"timeout": timeout, "connector": connector, **options})

    client: dict[str, Any] = {"get_client": get_client, "skip_instance_cache": True}
    if len(address.split("::")) == 1:
        client["block_size"] = 0  # one request, read as a stream
    return {part.partition("://")[0].lower(): client for part in parts}


def _socket_factory(addresses: list[str], *, private: bool) -> Callable[[Any], socket.socket]:
    """Return the socket factory of a client; it rejects private addresses, except named ones with ``private``."""
    named: set[str] = set()

    def make_socket(info: Any) -> socket.socket:  # noqa: ANN401  an item of getaddrinfo
        family, kind, protocol, _, address_info = info
        if not named:
            named.update(*map(_hosts, addresses))
        if (address_info[0] not in named or not private) and not _is_public(address_info[0]):
            shown = " and ".join(map(public_address, addresses))
            if address_info[0] in named:
                reason = f"{address_info[0]} is a private address"
                advice = "list the host in MAVNAV_FETCH_HOSTS on the workers"
            else:
                reason, advice = f"it redirects to the private address {address_info[0]}", "name that address itself"
            raise UsageError(f"{shown}: cannot be read ({reason}); {advice}")
        made = socket.socket(family, kind, protocol)
        made.setblocking(False)
        return made

    return make_socket


def _hosts(address: str) -> set[str]:
    """Return the numeric addresses of the host of a URL; empty if it has none."""
    with suppress(OSError, ValueError):
        return {str(entry[4][0]) for entry in socket.getaddrinfo(urlsplit(address).hostname, None)}
    return set()


def _is_public(host: str) -> bool:
    try:
        address_info = ip_address(host.partition("%")[0])
    except ValueError:
        return False
    mapped = getattr(address_info, "ipv4_mapped", None)
    return (mapped or address_info).is_global
