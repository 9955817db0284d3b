"""The server of `jaxreplay explore`: a page and a WebSocket, for this machine alone."""

import asyncio
import json
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from jaxreplay.errors import ConfigError

_ALLOWED = (  # all that the page needs is in it
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def serve(folder: Path | None, port: int, ready: Callable[[str], None]) -> None:
    """Serve until the process ends.

    The address has a random token in it. Without it, or for another Host or Origin, nothing is
    answered but an error.

    Args:
        folder: of the study that is shown; None: runs of the default study can be asked for.
        port: of 127.0.0.1; 0: any that is free.
        ready: called with the address when it can be opened.

    Raises:
        ConfigError: the port is taken, or may not be used.
    """
    asyncio.run(_serve(folder, port, ready))


async def _serve(folder: Path | None, port: int, ready: Callable[[str], None]) -> None:
    try:
        listening = socket.create_server(("127.0.0.1", port))
    except OSError as error:
        raise ConfigError(f"--port {port}: {error.strerror}; choose another, or none") from None
    listening.setblocking(False)
    number = listening.getsockname()[1]
    token = secrets.token_urlsafe(16)
    known = {"hosts": {f"127.0.0.1:{number}", f"localhost:{number}"}, "folder": folder}
    application = Application(
        [(f"/{token}/", _Page, known), (f"/{token}/live", _Live, known)],
        default_handler_class=_Nothing,
        websocket_max_message_size=100_000,
        log_function=lambda handler: None,
    )
    server = HTTPServer(application)
    server.add_socket(listening)
    ready(f"http://127.0.0.1:{number}/{token}/")
    await asyncio.Event().wait()


class _Handler(RequestHandler):
    """Answers only requests that are meant for this server."""

    def initialize(self, hosts: set[str], folder: Path | None) -> None:
        self.hosts, self.folder = hosts, folder

    def prepare(self) -> None:
        origin = self.request.headers.get("Origin")
        if self.request.host not in self.hosts:
            raise HTTPError(403)
        if origin is not None and urlsplit(origin).netloc != self.request.host:
            raise HTTPError(403)

    def set_default_headers(self) -> None:
        self.set_header("Content-Security-Policy", _ALLOWED)
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cache-Control", "no-store")
        self.clear_header("Server")

    def write_error(self, status_code: int, **_) -> None:
        self.finish(f"{status_code}\n")


class _Nothing(RequestHandler):
    """Answers what has no token."""

    def prepare(self) -> None:
        self.set_status(404)
        self.finish("404\n")


class _Page(_Handler):
    """The page."""

    def get(self) -> None:
        from jaxreplay.page.run import html

        self.write(html(None))


class _Live(WebSocketHandler, _Handler):
    """What is asked in the page, and the answers."""

    def check_origin(self, origin: str) -> bool:
        return urlsplit(origin).netloc == self.request.host

    def open(self, *_) -> None:
        from jaxreplay.explore.session import Session  # imports JAX

        loop = asyncio.get_running_loop()

        def send(message: dict[str, Any]) -> None:
            loop.call_soon_threadsafe(self._answer, message)

        self.session = Session(self.folder, send)

    def on_message(self, message: str | bytes) -> None:
        try:
            asked = json.loads(message)
        except ValueError:
            return
        if isinstance(asked, dict):
            try:
                self.session.receive(asked)
            except (TypeError, ValueError):  # nothing that the page sends
                self.close()

    def on_close(self) -> None:
        self.session.close()

    def _answer(self, message: dict) -> None:
        try:
            self.write_message(json.dumps(message, allow_nan=False))
        except WebSocketClosedError:
            self.session.close()
