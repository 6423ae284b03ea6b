"""The page's door: who may ask, and a thread that answers over HTTP on 127.0.0.1.

Any page in a browser on this machine can send requests here. So a request must name this address as its
host (against DNS rebinding), must not come from another site (Origin; W3C Fetch Metadata), and needs the
page's token, which no other site can read, to steer. A refusal closes the connection: what follows on it is
not read."""

import hmac
import logging
import secrets
import socket
import threading
from collections.abc import Sequence

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["TOKEN_HEADER", "Web"]

TOKEN_HEADER = "X-Optolever-Token"
_HOST = "127.0.0.1"
_NAMES = (_HOST, "localhost")
_CLIENTS = 16  # connections at a time; beyond, 503
_IDLE_S = 60  # s that a connection may be silent between requests
_END_S = 2  # s for the last answers
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
}


class Web:
    """Serves routes on a thread from `start` to `stop`. port 0: any free one; OSError if it is taken."""

    def __init__(self, routes: Sequence[BaseRoute], port: int) -> None:
        self.token = secrets.token_urlsafe(32)
        self._socket = socket.create_server((_HOST, port))
        self.address = f"http://{_HOST}:{self._socket.getsockname()[1]}/"
        config = uvicorn.Config(
            _Guard(Starlette(routes=routes), self.token),
            loop="asyncio", http="h11", ws="none", lifespan="off", interface="asgi3",
            log_config=None, log_level=logging.CRITICAL, access_log=False,
            proxy_headers=False, server_header=False,
            limit_concurrency=_CLIENTS, timeout_keep_alive=_IDLE_S, timeout_graceful_shutdown=_END_S,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._socket]}, daemon=True
        )

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def stop(self) -> None:
        """Finish the requests in progress, and close."""
        self._server.should_exit = True
        self._thread.join(timeout=2 * _END_S)
        self._socket.close()


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
