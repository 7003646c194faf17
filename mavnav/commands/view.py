"""``mavnav view RUN``: look around in a result, in the browser.

Examples
--------
mavnav view runs/drive-robust-20-10x10
mavnav view runs/batch --no-browser
mavnav view runs/compare --serve
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavnav.commands import shared, signals
from mavnav.commands.progress import loading_modules, reporting
from mavnav.commands.terminal import emit, note
from mavnav.errors import OutputError

if TYPE_CHECKING:
    from http.server import ThreadingHTTPServer

LOOPBACK = "127.0.0.1"


def view(
    directory: Annotated[Path, typer.Argument(metavar="RUN", show_default=False)],
    *,
    output: Annotated[Path | None, shared.output_option("--output", "-o", metavar="FILE.html")] = None,
    no_browser: Annotated[bool, shared.output_option("--no-browser")] = False,
    serve: Annotated[bool, shared.output_option("--serve")] = False,
    quiet: shared.Quiet = False,
) -> None:
    """Look around in a map: zoom, layers, every scan at its pose, reasons of doubt; runs side by side.

    Parameters
    ----------
    directory
        Directory of a run, comparison, merge or batch.
    output
        Where the page goes (default report.html or view.html in RUN).
    no_browser
        Write the page and print its path, without opening it.
    serve
        Write nothing; serve the page to this machine alone, until Ctrl-C.
    """
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.outputs.directory import check_file, write_file
            from mavnav.outputs.report.page import finished_page
        report("drawing the page", 0, None)
        name, text = finished_page(directory)
        page = text.encode("utf-8", "backslashreplace")  # names need not be UTF-8
    if serve:
        _serve(page)
        return
    path = output or directory / name
    if output is None and not os.access(directory, os.W_OK | os.X_OK):
        if not path.is_file():
            raise OutputError(f"{directory} is not writable; name another place for the page with -o")
        note(f"mavnav: {directory} is not writable; {path} is shown as it is")
    else:
        check_file(path, ".html", force=True)
        write_file(path, lambda partial: partial.write_bytes(page), force=True)
    emit(str(path))
    if not no_browser:
        import webbrowser

        if not webbrowser.open(path.absolute().as_uri()):
            note(f"mavnav: warning: no browser could be started; open {path}, or use --serve on a remote machine")


def _serve(page: bytes) -> None:
    server, address = page_server(page)
    emit(address)
    note(f"from another machine: ssh -L {server.server_port}:127.0.0.1:{server.server_port} HOST; Ctrl-C ends it")
    try:
        server.serve_forever()
    except signals.Interrupted:
        note("mavnav: stopped")
    finally:
        server.server_close()


def page_server(page: bytes) -> tuple[ThreadingHTTPServer, str]:
    """Return a server of a page on a free port of the loopback interface, and the page's address.

    The address has a random token: other users of the machine cannot guess it. Nothing but the page can be read, and
    nothing be written.
    """
    from hmac import compare_digest
    from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
    from secrets import token_urlsafe

    path = f"/{token_urlsafe(16)}/"

    class Handler(BaseHTTPRequestHandler):
        server_version, sys_version = "mavnav", ""

        def do_HEAD(self) -> None:
            known = compare_digest(self.path.encode(), path.encode())
            self.send_response(200 if known else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page) if known else 0))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()

        def do_GET(self) -> None:
            self.do_HEAD()
            if compare_digest(self.path.encode(), path.encode()):
                self.wfile.write(page)

        def log_message(self, *_: object) -> None:
            """Print nothing."""

    server = ThreadingHTTPServer((LOOPBACK, 0), Handler)
    return server, f"http://{LOOPBACK}:{server.server_port}{path}"
