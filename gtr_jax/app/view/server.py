"""The page served to this machine: a Bokeh server on 127.0.0.1, behind its guard."""

from __future__ import annotations

import errno
import socket
from collections.abc import Callable
from pathlib import Path

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.core.validation import silence
from bokeh.core.validation.warnings import EMPTY_LAYOUT
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.iostream import IOStream
from tornado.netutil import bind_sockets
from tornado.web import StaticFileHandler

from gtr_jax.errors import InputError

from .guard import Guard

HERE = "127.0.0.1"
MOST_PORTS = 65535
SEPARATE = "sandbox allow-scripts allow-popups allow-downloads; frame-ancestors 'none'"
silence(EMPTY_LAYOUT)  # places for what comes later, such as the physics terms


class _Prompt(HTTPServer):
    """Sends every message at once. Tornado lets the system collect what a socket sends, which delays each
    answer by 40 ms until the browser has acknowledged the part before it.
    """

    def handle_stream(self, stream: IOStream, address: tuple) -> None:
        """Serve one connection."""
        stream.set_nodelay(True)
        # Tornado switches it off again after the request that opens a socket.
        stream.set_nodelay = lambda value: None
        super().handle_stream(stream, address)


class _Runs(StaticFileHandler):
    def set_extra_headers(self, path: str) -> None:
        """Scripts of a report run in it, and reach nothing of the page."""
        self.set_header("Content-Security-Policy", SEPARATE)


class Server:
    """The page's server, which listens once it is made and answers while `run` runs.

    Args:
        fill: fills a new document; called for each tab that opens the page.
        runs: folder whose files are shown.
        shown_at: the path that they are shown at; secret, as the cookie alone is enough to see them.
        port: to listen on; 0 for a free one.

    Raises:
        InputError: the port is taken, or may not be used.
    """

    def __init__(self, fill: Callable[[Document], None], runs: Path, shown_at: str, port: int = 0) -> None:
        sockets = _listening(port)
        self.port = sockets[0].getsockname()[1]
        self.guard = Guard(self.port)
        pages = BokehTornado(
            {"/": Application(FunctionHandler(fill))},
            extra_websocket_origins=[f"{HERE}:{self.port}", f"localhost:{self.port}"],
            extra_patterns=[(rf"/{shown_at}/(.*)", _Runs, {"path": str(runs.resolve())})],
        )
        http = _Prompt(self.guard.around(pages))
        http.add_sockets(sockets)
        self._server = BaseServer(IOLoop.current(), pages, http)
        self._server.start()

    def address(self, used: Callable[[], object] = lambda: None) -> str:
        """Where the page is, with a token that lets one browser in; `used` is called once it has."""
        return f"http://{HERE}:{self.port}/?token={self.guard.key(used)}"

    def run(self) -> None:
        """Answer requests until KeyboardInterrupt, or `stop`."""
        self._server.io_loop.start()

    def stop(self) -> None:
        """Let `run` return; from any thread."""
        self._server.io_loop.add_callback(self._server.io_loop.stop)

    def close(self) -> None:
        """Refuse new connections, end all tabs' sessions, and free the port."""
        self._server.unlisten()
        self._server.stop()
        self._server.io_loop.close()


def _listening(port: int) -> list[socket.socket]:
    if not 0 <= port <= MOST_PORTS:
        raise InputError(f"--port: {port} is not a port; leave it out for a free one")
    try:
        return bind_sockets(port, HERE, family=socket.AF_INET)
    except OSError as fault:
        why = "is in use" if fault.errno == errno.EADDRINUSE else f"cannot be used ({fault.strerror})"
        raise InputError(f"--port: {port} {why}; leave it out for a free one") from None
