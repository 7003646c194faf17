"""``mavnav view RUN``: look around in a result, in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mavnav.commands import shared, signals
from mavnav.commands.progress import loading_modules, reporting
from mavnav.commands.terminal import emit, note

EPILOG = """
[bold]Examples[/bold]
mavnav view runs/drive-robust-20-10x10
mavnav view runs/batch --no-browser
mavnav view runs/compare --serve
"""


def view(
    directory: Annotated[
        Path, typer.Argument(metavar="RUN", help="Directory of a run, comparison, merge or batch.", show_default=False)
    ],
    *,
    output: Annotated[
        Path | None,
        shared.output_option(
            "--output", "-o", metavar="FILE.html", help="Where the page goes (default report.html or view.html in RUN)."
        ),
    ] = None,
    no_browser: Annotated[
        bool, shared.output_option("--no-browser", help="Write the page and print its path, without opening it.")
    ] = False,
    serve: Annotated[
        bool, shared.output_option("--serve", help="Write nothing; serve the page to this machine alone, until Ctrl-C.")
    ] = False,
    quiet: shared.Quiet = False,
) -> None:
    """Look around in a map: zoom, layers, every scan at its pose, reasons of doubt; runs side by side."""
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.outputs.report.page import finished_page
        report("drawing the page", 0, None)
        name, text = finished_page(directory)
        page = text.encode("utf-8", "backslashreplace")  # names need not be UTF-8
    if serve:
        _serve(page)
        return
    path = _write(page, output or directory / name)
    emit(str(path))
    if not no_browser:
        import webbrowser

        if not webbrowser.open(path.absolute().as_uri()):
            note(f"mavnav: warning: no browser could be started; open {path}, or use --serve on a remote machine")


def _write(page: bytes, path: Path) -> Path:
    from mavnav.outputs.directory import check_file, write_file

    check_file(path, ".html", force=True)
    write_file(path, lambda partial: partial.write_bytes(page), force=True)
    return path


def _serve(page: bytes) -> None:
    from mavnav.commands.page_server import page_server

    server, address = page_server(page)
    emit(address)
    note(f"from another machine: ssh -L {server.server_port}:127.0.0.1:{server.server_port} HOST; Ctrl-C ends it")
    try:
        server.serve_forever()
    except signals.Interrupted:
        note("mavnav: stopped")
    finally:
        server.server_close()
