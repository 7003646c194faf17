"""Logs at addresses: any file that fsspec can open is copied to a temporary folder while it is needed.

Time, size and data rate of the copy are limited, because a server may never answer, never end, or be very slow.
The client of web servers follows no redirection into private networks that the user did not name. A log that is known
by the SHA-256 of its file is one of a folder of copies, or fetched once into the cache and checked.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from http import HTTPStatus
from io import FileIO
from ipaddress import ip_address
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread
from time import monotonic
from typing import Any, Final
from urllib.parse import urlsplit

from msgspec import Struct, field

from mavnav.atomic_files import writing
from mavnav.errors import MavnavError, OutputError, UsageError
from mavnav.jobs.dask import in_cluster
from mavnav.kernels.machine.cache import user_directory
from mavnav.outputs.directory import file_sha256
from mavnav.outputs.documents.addresses import public_address, public_text
from mavnav.profiling import Progress

_TIMEOUT: Final = "MAVNAV_FETCH_TIMEOUT_S"
PIECE_BYTES: Final = 2**20
IDLE_S: Final = 60.0
"""Time without data after which a download is aborted, and after which its rate must exceed `MIN_RATE`, in s."""

MIN_RATE: Final = 1000.0
"""Minimum average rate of a download, in bytes/s."""


class DownloadLimits(Struct, frozen=True):
    """Limits of a download: total time, time without data, size, and whether private networks are allowed."""

    total_s: float
    idle_s: float
    max_bytes: float
    private: bool
    """Whether the address may name a host of a private network."""


def limits() -> DownloadLimits:
    """Return the limits of the ``MAVNAV_FETCH_*`` variables; raises UsageError for a value that is no number."""
    total_s = _number(_TIMEOUT, 3600.0)
    max_bytes = 1e6 * _number("MAVNAV_FETCH_MAX_MB", 65_536.0)
    return DownloadLimits(total_s, min(IDLE_S, total_s), max_bytes, private=any(_allowed_hosts()) or not in_cluster())


def _number(variable: str, default: float) -> float:
    text = os.environ.get(variable) or str(default)
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not (isfinite(number) and number > 0.0):
        raise UsageError(f"{variable} is {text!r}; set it to a number above 0")
    return number


@contextmanager
def download(address: str) -> Iterator[Path]:
    """Yield a temporary folder with the log; its relative path in the folder is its address.

    User name, password and query of the address are left out of the path and of errors. Raises UsageError if the
    address cannot be opened, a limit of `limits` is exceeded, or fsspec is missing, and OutputError if the temporary
    folder cannot be written.
    """
    path = Path(public_address(address))
    if ".." in path.parts:
        raise UsageError(f"{public_address(address)}: an address with '..'; write it out")
    check_allowed(address)
    with TemporaryDirectory(prefix="mavnav-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        with _writing(address):
            (folder / path).parent.mkdir(parents=True)
        _Copy(address, folder / path, limits()).run()
        yield folder


def fetch(address: str, file: Path, size_bytes: int, on_bytes: Callable[[int], None]) -> None:
    """Download an address of known size into a file, from where an earlier call was interrupted.

    ``on_bytes`` is called with the bytes that are there. Raises as `download`; what has come is kept in the file.
    """
    check_allowed(address)
    begin = file.stat().st_size if file.exists() else 0
    if begin < size_bytes:
        _Copy(address, file, limits(), size_bytes, begin).run(on_bytes)


def check_allowed(address: str) -> None:
    """Raise UsageError for hosts that ``MAVNAV_FETCH_HOSTS`` does not list, and for non-regular local files."""
    allowed = _allowed_hosts()
    shown = public_address(address)
    *inner, outer = shown.split("::")
    for part in (*(part for part in inner if part.lower().startswith("http")), outer):
        scheme, _, rest = part.partition("://")
        if scheme.lower() in {"file", "local"}:
            if Path(rest).exists() and not Path(rest).is_file():
                raise UsageError(f"{shown}: cannot be read (it is not a regular file); name a log")
        elif rest and any(allowed):
            host = (urlsplit(part).hostname or "").lower()
            if not any(fnmatchcase(host, pattern) for pattern in allowed if pattern):
                raise UsageError(f"{shown}: {host or scheme} is not one of MAVNAV_FETCH_HOSTS; add it there")


def _allowed_hosts() -> list[str]:
    return [pattern.strip().lower() for pattern in os.environ.get("MAVNAV_FETCH_HOSTS", "").split(",")]


@contextmanager
def _writing(address: str) -> Iterator[None]:
    """Raise OutputError where the temporary folder cannot be written."""
    try:
        yield
    except OSError as error:
        reason = f"the temporary folder cannot be written ({error.strerror or error})"
        advice = "make room, or set TMPDIR to another folder"
        raise OutputError(f"{public_address(address)}: {reason}; {advice}") from error


class _Copy(Struct):
    """Download of an address in a thread, which is abandoned when a limit is exceeded."""

    address: str
    file: Path
    limits: DownloadLimits
    size_bytes: int | None = None
    begin_bytes: int = 0
    """Bytes that the file has already; a server that cannot begin there sends all."""
    began_s: float = field(default_factory=monotonic)
    latest_s: float = field(default_factory=monotonic)
    done_bytes: int = 0
    stop: Event = field(default_factory=Event)
    ended: Event = field(default_factory=Event)
    error: Exception | None = None

    def run(self, on_bytes: Callable[[int], None] = lambda _: None) -> None:
        """Download the file; raises MavnavError."""
        Thread(target=self._work, daemon=True).start()
        try:
            while not self.ended.wait(0.05):
                on_bytes(self.begin_bytes + self.done_bytes)
                self._check()
        finally:
            self.stop.set()
        if self.error is not None:
            raise self._public_error(self.error) from None

    def _work(self) -> None:
        try:
            self._copy()
        except Exception as error:  # every protocol has its own exceptions
            self.error = error
        finally:
            self.ended.set()

    def _copy(self) -> None:
        with _open(self.address, self.limits, self.begin_bytes) as source:
            self.begin_bytes = self.begin_bytes if _begins_at(source, self.begin_bytes) else 0
            with _writing(self.address):
                copy = self.file.open("ab" if self.begin_bytes else "wb", buffering=0)
            with copy:
                while not self.stop.is_set() and (piece := source.read(PIECE_BYTES)):
                    self.done_bytes += len(piece)
                    self.latest_s = monotonic()
                    if self.done_bytes > self.limits.max_bytes:
                        raise self._refusal(f"larger than {self.limits.max_bytes / 1e6:g} MB", "MAVNAV_FETCH_MAX_MB")
                    self._put(copy, memoryview(piece))
                    if self.size_bytes and self.begin_bytes + self.done_bytes > self.size_bytes:
                        return

    def _put(self, copy: FileIO, left: memoryview) -> None:
        with _writing(self.address):
            while left:
                left = left[copy.write(left) :]

    def _timeout_error(self) -> UsageError:
        if monotonic() - self.began_s > self.limits.total_s:
            return self._refusal(f"not complete after {self.limits.total_s:g} s", _TIMEOUT)
        return self._refusal(f"no data for {self.limits.idle_s:g} s", _TIMEOUT)

    def _check(self) -> None:
        """Raise UsageError if a limit of time or rate is exceeded."""
        now_s = monotonic()
        elapsed_s = now_s - self.began_s
        if elapsed_s > self.limits.total_s or now_s - self.latest_s > self.limits.idle_s:
            raise self._timeout_error()
        if elapsed_s > self.limits.idle_s and self.done_bytes < MIN_RATE * elapsed_s:
            raise self._refusal(f"less than {MIN_RATE:g} bytes/s for {self.limits.idle_s:g} s", _TIMEOUT)

    def _refusal(self, reason: str, variable: str) -> UsageError:
        advice = f"download it by other means, or set {variable}"
        return UsageError(f"{public_address(self.address)}: cannot be read ({reason}); {advice}")

    def _public_error(self, error: Exception) -> MavnavError:
        shown = public_address(self.address)
        while isinstance(error, FileNotFoundError) and isinstance(error.__cause__, Exception):
            error = error.__cause__  # fsspec wraps every error before the first byte in a FileNotFoundError
        if isinstance(error, MavnavError):
            return error
        if isinstance(error, FileNotFoundError) or getattr(error, "status", None) == 404:
            return UsageError(f"{shown}: there is no such file; check the address")
        if type(error).__name__ == "TooManyRedirects":
            return UsageError(f"{shown}: cannot be read (it redirects without end); check the address")
        if isinstance(error, TimeoutError) and error.errno is None:  # the client's own time limit
            return self._timeout_error()
        reason = " ".join(public_text(str(error), self.address).split()) or type(error).__name__
        advice = "check the address and the permissions"
        if isinstance(error, ImportError):  # of fsspec and aiohttp, or what fsspec says to install
            named = "pip install 'mavnav[cluster]'" if isinstance(error, ModuleNotFoundError) else "install it"
            advice = f"{named}, or download the log by other means"
        return UsageError(f"{shown}: cannot be read ({reason}); {advice}")


def _begins_at(source: Any, begin_bytes: int) -> bool:  # noqa: ANN401  an open file of fsspec
    """Go to a byte of an open address; a stream of a web server begins there if its answer is partial content."""
    if response := getattr(source, "r", None):
        return int(response.status) == HTTPStatus.PARTIAL_CONTENT
    source.seek(begin_bytes)
    return True


def _open(address: str, bounds: DownloadLimits, begin_bytes: int) -> Any:  # noqa: ANN401  an open file of fsspec
    """Open an address; one of a web server is read as a stream, with its redirections checked."""
    import fsspec  # noqa: PLC0415  an extra

    options = client_options(address, bounds)
    for client in options.values() if begin_bytes else ():
        client["headers"] = {"Range": f"bytes={begin_bytes}-"}
    return fsspec.open(address, "rb", **options)


def client_options(address: str, bounds: DownloadLimits) -> dict[str, Any]:
    """Return the options of ``fsspec.open`` for an address; none for one without ``http(s)://`` in it.

    A request may take ``total_s`` of the limits in all and ``idle_s`` without data. A host of a private network is
    allowed only with ``private`` and if the address itself names it; a redirection to another one raises UsageError.
    """
    parts = [part for part in address.split("::") if part.lower().startswith(("http://", "https://"))]
    if not parts:
        return {}
    import aiohttp  # noqa: PLC0415  an extra

    timeout = aiohttp.ClientTimeout(total=bounds.total_s, sock_connect=bounds.idle_s, sock_read=bounds.idle_s)
    make_socket = _socket_factory(parts, private=bounds.private)

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
    return (getattr(address_info, "ipv4_mapped", None) or address_info).is_global


class Pin(Struct, frozen=True):
    """The content of the file at an address: its SHA-256, in hexadecimal digits, and its size."""

    sha256: str
    size_bytes: int


def pinned_file(address: str, pin: Pin, copies: Path | None, progress: Progress) -> Path:
    """Return a file with the pinned content: one below the folder ``copies``, or that in the cache, fetched if need be.

    An interrupted download goes on at the next call. Raises UsageError for an address that cannot be read, or has
    other content, and OutputError if the cache cannot be written.
    """
    if copies and not copies.is_dir():
        raise UsageError(f"{copies} is no folder; name that of your copies with --copies")
    for path in sorted(copies.rglob("*")) if copies else ():
        if _has(path, pin):
            return path
    if (cache := user_directory()) is None:
        raise OutputError("no cache for logs is known; set MAVNAV_CACHE_DIR to an absolute path")
    path = cache / "logs" / pin.sha256[:16] / Path(public_address(address)).name
    if not _has(path, pin):
        _fetch_checked(address, pin, path, progress)
    return path


def _has(path: Path, pin: Pin) -> bool:
    return path.is_file() and path.stat().st_size == pin.size_bytes and file_sha256(path) == pin.sha256


def _fetch_checked(address: str, pin: Pin, path: Path, progress: Progress) -> None:
    """Download a file into the cache; one with other content is removed, one that is cut off is kept to go on with."""
    shown, part = public_address(address), path.with_name(f"{path.name}.part")
    phase, total_kb = f"fetching {path.name}, kB", pin.size_bytes // 1000
    with writing(part, "make room, or set MAVNAV_CACHE_DIR to another directory"):
        part.parent.mkdir(parents=True, exist_ok=True)
        progress(phase, 0, total_kb)
        fetch(address, part, pin.size_bytes, lambda there: progress(phase, there // 1000, total_kb))
        if (size := part.stat().st_size) < pin.size_bytes:
            what = f"it ended after {size} of {pin.size_bytes} bytes"
            raise UsageError(f"{shown}: {what}; the same call goes on from there")
        if (sha256 := file_sha256(part)) != pin.sha256:
            part.unlink()
            advice = "the file there was changed, or damaged on the way: try again, or give a copy with --copies"
            raise UsageError(f"{shown}: its SHA-256 is {sha256}, not {pin.sha256}; {advice}")
        part.replace(path)
