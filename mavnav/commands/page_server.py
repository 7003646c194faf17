"""A page over HTTP on this machine alone, for ``mavnav view --serve``."""

from __future__ import annotations

from hmac import compare_digest
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from secrets import token_urlsafe

LOOPBACK = "127.0.0.1"


def page_server(page: bytes) -> tuple[ThreadingHTTPServer, str]:
    """Return a server of a page on a free port of the loopback interface, and the page's address.

    The address has a random token: other users of the machine cannot guess it. Nothing but the page can be read, and
    nothing be written.
    """
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
