"""The page's door: its files, who may ask, and a thread that answers over HTTP on 127.0.0.1.

Any page in a browser on this machine can send requests here. So a request must name this address as its
host (against DNS rebinding), must not come from another site (Origin; W3C Fetch Metadata), and needs the
page's token, which no other site can read, to steer. A refusal closes the connection: what follows on it is
not read. Nothing but this server's own files is executed or shown (Content-Security-Policy). A connection on
which no whole request comes within five seconds is closed."""

import asyncio
import hmac
import logging
import secrets
import socket
import threading
from collections.abc import Sequence
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from optolever.charts import chart_file
from optolever.errors import InputError

__all__ = ["TOKEN_HEADER", "Web"]

TOKEN_HEADER = "X-Optolever-Token"
_HOST = "127.0.0.1"
_NAMES = (_HOST, "localhost")
_CLIENTS = 16  # connections at a time; beyond, 503
_IDLE_S = 5  # s in which a whole request must come
_END_S = 2  # s for the last answers
_PAGE = Path(__file__).with_name("page")
_FILES = {
    "/": (_PAGE / "page.html", "text/html"),
    "/live.js": (_PAGE / "live.js", "text/javascript"),
    "/live.css": (_PAGE / "live.css", "text/css"),
    "/icon.svg": (_PAGE / "icon.svg", "image/svg+xml"),
    "/uplot.min.js": (chart_file("uplot.min.js"), "text/javascript"),
    "/uplot.min.css": (chart_file("uplot.min.css"), "text/css"),
}
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'",
    "Cache-Control": "no-store",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
}


class Web:
    """Serves the page and routes on a thread from `start` to `stop`. port 0: any free one; InputError if
    it is taken."""

    def __init__(self, routes: Sequence[BaseRoute], port: int) -> None:
        self.token = secrets.token_urlsafe(32)
        try:
            self._socket = socket.create_server((_HOST, port))
        except OSError as error:
            raise InputError(f"--port {port}: {error.strerror or error}; name another") from error
        self.address = f"http://{_HOST}:{self._socket.getsockname()[1]}/"
        config = uvicorn.Config(
            _Guard(Starlette(routes=[*routes, *(Route(path, self._file) for path in _FILES)]), self.token),
            loop="asyncio", http=_Punctual, ws="none", lifespan="off", interface="asgi3",
            log_config=None, log_level=logging.CRITICAL, access_log=False,
            proxy_headers=False, server_header=False,
            limit_concurrency=_CLIENTS, timeout_keep_alive=_IDLE_S, timeout_graceful_shutdown=_END_S,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._socket]}, daemon=True
        )

    async def _file(self, request: Request) -> Response:
        """Of the page; its token is put in."""
        path, kind = _FILES[request.url.path]
        text = path.read_text(encoding="utf-8")
        return Response(
            text.replace("{{token}}", self.token) if kind == "text/html" else text, media_type=kind
        )

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def stop(self) -> None:
        """Finish the requests in progress, and close."""
        self._server.should_exit = True
        self._thread.join(timeout=2 * _END_S)
        self._socket.close()


class _Punctual(H11Protocol):
    """Closes a connection on which no whole request comes in time, the first as well as the next."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._begun = self.loop.time()
        self._wait()

    def data_received(self, data: bytes) -> None:
        idle = self.timeout_keep_alive_task is not None and self.cycle is not None
        if idle and self.cycle.response_complete:  # the next request begins
            self._begun = self.loop.time()
        super().data_received(data)
        if (self.cycle is None or self.cycle.response_complete) and self.timeout_keep_alive_task is None:
            self._wait()

    def _wait(self) -> None:
        left = max(0.0, self._begun + _IDLE_S - self.loop.time())
        self.timeout_keep_alive_task = self.loop.call_later(left, self.timeout_keep_alive_handler)


class _Guard:
    """Refuses what the page has not sent, and closes after every refusal."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(_HEADERS)
                if message["status"] >= 400:
                    headers["Connection"] = "close"
            await send(message)

        allowed = _allowed(scope["method"], scope["path"], Headers(scope=scope), self._token)
        app = self._app if allowed else PlainTextResponse("not from here", 403)
        await app(scope, receive, sent)


def _allowed(method: str, path: str, headers: Headers, token: str) -> bool:
    name, _, _ = headers.get("host", "").rpartition(":")
    if name not in _NAMES:
        return False
    origin = headers.get("origin")
    if origin is not None and origin.rstrip("/") != f"http://{headers['host']}":
        return False
    if path != "/" and headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
        return False
    shown = headers.get(TOKEN_HEADER, "")
    return method in ("GET", "HEAD") or hmac.compare_digest(shown.encode(), token.encode())
