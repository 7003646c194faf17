"""Servers that never answer, never end, or lead elsewhere: one line each, in bounded time and space."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import pytest

from mavnav.batch import remote
from mavnav.batch.remote import download
from mavnav.errors import ExitCode, OutputError, UsageError
from support.small_batch import batch

pytest.importorskip("fsspec", reason="the extra mavnav[cluster]")
pytest.importorskip("aiohttp", reason="the extra mavnav[cluster]")

Answer = Callable[[socket.socket, Event, str], None]


def silence(_: socket.socket, end: Event, __: str) -> None:
    end.wait()


def without_end(client: socket.socket, end: Event, _: str) -> None:
    client.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
    while not end.is_set():
        client.sendall(bytes(2**16))


def a_byte_now_and_then(client: socket.socket, end: Event, _: str) -> None:
    client.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1000000\r\n\r\n")
    while not end.wait(0.05):
        client.sendall(b"x")


def a_head_without_end(client: socket.socket, end: Event, _: str) -> None:
    client.sendall(b"HTTP/1.1 200 OK\r\n")
    while not end.is_set():
        client.sendall(b"X-More: and more\r\n")


def redirect(target: str) -> Answer:
    def answer(client: socket.socket, _: Event, me: str) -> None:
        client.sendall(
            f"HTTP/1.1 302 Found\r\nConnection: close\r\nLocation: {target or me}\r\nContent-Length: 0\r\n\r\n".encode()
        )

    return answer


def half(client: socket.socket, _: Event, __: str) -> None:
    client.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n" + bytes(500))


def whole(client: socket.socket, end: Event, me: str) -> None:
    client.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\nConnection: close\r\n\r\nwhole")


@contextmanager
def serving(answer: Answer) -> Iterator[str]:
    """Serve one address on the loopback; ``answer`` has the connection, after the request."""
    end = Event()

    def talk(client: socket.socket, me: str) -> None:
        with client:
            try:
                asked = client.recv(2**16)
                if asked.startswith(b"HEAD") and answer is a_byte_now_and_then:
                    client.sendall(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n")
                else:
                    answer(client, end, me)
            except OSError:
                pass

    def listen(server: socket.socket, me: str) -> None:
        while True:
            try:
                client, _ = server.accept()
            except OSError:
                return
            Thread(target=talk, args=(client, me), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as server:
        me = f"http://127.0.0.1:{server.getsockname()[1]}/a.mcap"
        thread = Thread(target=listen, args=(server, me), daemon=True)
        thread.start()
        try:
            yield me
        finally:
            end.set()
            server.shutdown(socket.SHUT_RDWR)
            thread.join()


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (silence, "not complete after 0.3 s|no data for 0.3 s"),
        (without_end, "larger than 2 MB"),
        (a_byte_now_and_then, "not complete after 0.3 s|less than 1000 bytes/s"),
        (a_head_without_end, "[^;]+"),
        (redirect(""), "it redirects without end"),
        (redirect("http://127.0.0.2:9/"), "it redirects to the private address 127.0.0.2"),
        (redirect("http://[::1]:9/"), "it redirects to the private address ::1"),
        (redirect("http://169.254.169.254/x"), "it redirects to the private address 169.254.169.254"),
        (redirect("file:///etc/hostname"), "[^;]+"),
        (half, "[^;]+"),
    ],
)
def test_a_bad_server_is_one_line_in_bounded_time(
    answer: Answer, said: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("MAVNAV_FETCH_TIMEOUT_S", "0.3" if "0.3" in said else "20")
    monkeypatch.setenv("MAVNAV_FETCH_MAX_MB", "2")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    began_s = time.monotonic()
    with serving(answer) as address:
        secret = address.replace("://", "://alice:hunter2@") + "?sig=SECRET"
        with pytest.raises(UsageError, match=rf"{address}: cannot be read \(({said})\); ") as caught, download(secret):
            pass
    text = str(caught.value)
    assert not any(word in text for word in ("\n", "alice", "hunter2", "SECRET"))
    assert time.monotonic() - began_s < 30.0  # the usual limit is 60 s
    assert not list(tmp_path.iterdir())


def test_a_slow_server_is_given_up_before_the_time_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "IDLE_S", 0.2)
    for answer, said in ((silence, "no data for 0.2 s"), (a_byte_now_and_then, "less than 1000 bytes/s for 0.2 s")):
        with serving(answer) as address, pytest.raises(UsageError, match=said), download(address):
            pass


def test_a_bad_server_fails_alone_in_a_batch(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAVNAV_FETCH_TIMEOUT_S", "0.3")
    with serving(silence) as address:
        document, ran = batch(sources=(address, "logs/good.mcap"))
    assert [row["exit_code"] for row in document["cells"]] == [ExitCode.USAGE, ExitCode.DONE]
    assert "MAVNAV_FETCH_TIMEOUT_S" in document["cells"][0]["error"]
    assert ran == []


@pytest.mark.parametrize("value", ["soon", "0", "-1", "nan", "inf"])
def test_a_limit_that_is_none_is_refused(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAVNAV_FETCH_MAX_MB", value)
    with pytest.raises(UsageError, match=r"MAVNAV_FETCH_MAX_MB is '.*'; set it to a number above 0"):
        remote.limits()


def test_a_full_temporary_folder_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "mkdir", full)
    with pytest.raises(OutputError, match=r"No space left on device.*TMPDIR"), download("file:///etc/hostname"):
        pass


@pytest.mark.parametrize(
    ("address", "allowed"),
    [
        ("http://data.example.org/a.mcap", True),
        ("https://alice:hunter2@B.Example.com:8443/a.mcap?sig=SECRET", True),
        ("s3://drives/a.mcap", True),
        ("zip://a.mcap::https://data.example.org/a.zip", True),
        ("file:///etc/hostname", True),
        ("https://example.com/a.mcap", False),
        ("https://data.example.org@127.0.0.1/a.mcap", False),
        ("s3://others/a.mcap", False),
        ("zip://a.mcap::https://127.0.0.1/a.zip", False),
        ("file:///dev/zero", False),
        ("file:///dev", False),
    ],
)
def test_only_hosts_of_the_list_are_asked(address: str, allowed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAVNAV_FETCH_HOSTS", "data.example.org, *.example.com,drives")
    if allowed:
        remote.check_allowed(address)
    else:
        with pytest.raises(UsageError, match=r"MAVNAV_FETCH_HOSTS|regular file"):
            remote.check_allowed(address)


def test_a_worker_of_a_cluster_enters_private_networks_only_where_its_list_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(remote, "in_cluster", lambda: True)
    with serving(whole) as address:
        with pytest.raises(UsageError, match=r"127\.0\.0\.1 is a private address\); list the host"), download(address):
            pass
        monkeypatch.setenv("MAVNAV_FETCH_HOSTS", "127.0.0.1")
        with download(address) as folder:
            assert next(file for file in folder.rglob("*") if file.is_file()).read_bytes() == b"whole"


@pytest.mark.parametrize(("early_s", "said"), [(0.0, "no data for 60 s"), (4000.0, "not complete after 3600 s")])
def test_a_limit_that_the_client_reaches_first_is_explained(early_s: float, said: str, tmp_path: Path) -> None:
    copy = remote._Copy("http://h/a.mcap", tmp_path / "a", remote.limits())
    copy.began_s -= early_s
    assert str(copy._public_error(TimeoutError())).startswith(f"http://h/a.mcap: cannot be read ({said}); ")
