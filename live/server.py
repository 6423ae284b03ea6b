"""LiveServer: a page on this machine that shows a camera's readings as they come.

`GET /` is the page, `GET /next?after=N` waits for a reading newer than N: the page asks for the next when it
has drawn one, so that nothing queues up. The answer holds four lengths (little-endian uint32), then JSON of
the numbers, two JPEGs (camera, sigma) and the height as float32 in micrometres on a grid whose size is in the
JSON. `POST /pause`, `/resume`, `/tare` steer; `GET /snapshot` is the last reading as .npz. Pictures are made
when somebody asks."""

import http.server
import io
import json
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from .arrays import Cells, Frame
from .follow import Followed, follow, tared
from .prepared import Prepared
from .recorded import ReadingRecorder
from .source import Newest, Source
from .stream import Live

__all__ = ["LiveServer"]

_PAGE = Path(__file__).with_name("page.html")
_TROUBLED = 0.5  # s between the answers of a camera that is gone
_WAIT = 5.0  # s that a request waits for a reading
_GRID = 96  # columns of the height that is sent, at most
_TARE = 8  # frames
_RECENT = 60  # frames over which the rate is counted
_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 80)
_HOSTS = ("127.0.0.1", "localhost")


class LiveServer:
    """Reads a source on a thread and serves the page on another. A context manager; port 0: any free one;
    record: gets every reading, which excludes tare."""

    def __init__(
        self, prepared: Prepared, source: Source, port: int = 0, record: ReadingRecorder | None = None
    ) -> None:
        self._record = record
        self._live, self._source = Live(prepared), Newest(source)
        self._changed = threading.Condition()
        self._latest: Followed | None = None
        self._count = 0
        self._times: deque[float] = deque(maxlen=_RECENT)
        self._resting: list[Frame] | None = None
        self._told = ""
        self._error = ""
        self._paused, self._over = False, False
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", port), _handler(self))
        self._threads = [
            threading.Thread(target=self._server.serve_forever, daemon=True),
            threading.Thread(target=self._follow, daemon=True),
        ]

    @property
    def address(self) -> str:
        """Of the page."""
        return f"http://127.0.0.1:{self._server.server_address[1]}/"

    @property
    def readings(self) -> int:
        """Number of readings so far."""
        return self._count

    @property
    def error(self) -> str:
        """Why it reads no more; empty while it does."""
        return self._error

    def __enter__(self) -> "LiveServer":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over = True
        self._server.shutdown()
        self._server.server_close()
        self._threads[1].join(timeout=5.0)

    def command(self, name: str) -> str:
        """Execute pause, resume or tare; returns the outcome in words. Tare is refused during a contact."""
        with self._changed:
            latest = self._latest
            if name == "pause":
                self._paused, self._told = True, "paused"
            elif name == "resume":
                self._paused, self._told = False, ""
            elif self._record is not None:
                self._told = "tare refused: it would change the rest of the recording"
            elif latest is None or not latest.reading.trusted or latest.reading.touches:
                self._told = "tare refused: something touches, or the frame is not trusted"
            else:
                self._resting, self._told = [], "tare: hold still"
            return self._told

    def answer(self, after: int) -> bytes | None:
        """The body for a reading newer than `after`; None: none came."""
        with self._changed:
            self._changed.wait_for(lambda: self._count > after or bool(self._error), _WAIT)
            latest, count, told, error = self._latest, self._count, self._told, self._error
            times = list(self._times)
        if latest is None or (count <= after and not error):
            return None
        if error:
            time.sleep(_TROUBLED)
        rate = (len(times) - 1) / max(times[-1] - times[0], 1e-9)
        state = {"count": count, "rate": rate, "told": told or error, "skipped": self._source.skipped}
        return _body(latest, state)

    def snapshot(self) -> bytes | None:
        """The last reading and its frame as .npz."""
        latest = self._latest
        if latest is None:
            return None
        reading, stream = latest.reading, io.BytesIO()
        maps = {name: getattr(reading, name) for name in ("x", "y", "z", "sigma", "good")}
        np.savez(stream, frame=latest.image.pixels, numbers=json.dumps(_plain(latest.to_dict())), **maps)
        return stream.getvalue()

    def _follow(self) -> None:
        try:
            with self._source as source:
                for followed in follow(self._live, source):
                    if self._over:
                        return
                    self._take(followed)
        except Exception as error:  # the page says it
            with self._changed:
                self._error = str(error)
                self._changed.notify_all()

    def _take(self, followed: Followed) -> None:
        if self._record is not None:
            self._record.write(followed)
        with self._changed:
            if self._resting is not None:
                self._resting.append(followed.image.pixels)
                if followed.reading.touches or not followed.reading.trusted:
                    self._resting, self._told = None, "tare refused: it was touched meanwhile"
                elif len(self._resting) >= _TARE:
                    self._live = Live(tared(self._live.prepared, np.stack(self._resting)))
                    self._resting, self._told = None, "tared"
            if not self._paused:
                self._latest, self._count = followed, self._count + 1
                self._times.append(time.monotonic())
                self._changed.notify_all()


def _body(followed: Followed, state: dict[str, Any]) -> bytes:
    reading = followed.reading
    z, factor = _small(np.where(reading.good, 1e3 * reading.z, np.nan).astype(np.float32))
    sigma = np.where(reading.good, reading.sigma, np.nan)
    typical = float(np.nanmedian(sigma)) if reading.good.any() else 1.0
    x, y = reading.x[::factor, ::factor], reading.y[::factor, ::factor]
    numbers = followed.to_dict() | state | {"rows": z.shape[0], "cols": z.shape[1]}
    numbers |= {"extent": [float(x.min()), float(x.max()), float(y.min()), float(y.max())]}
    numbers |= {"sigma_um": 1e3 * typical, "lost": reading.figures.lost, "noise": reading.figures.noise}
    frame = followed.image.pixels
    camera = frame if frame.dtype == np.uint8 else (frame >> 8).astype(np.uint8)
    trust = _jpeg(_coloured((sigma / (4 * typical)).astype(np.float32)))
    parts = [json.dumps(_plain(numbers)).encode(), _jpeg(camera), trust, z.tobytes()]
    return np.array([len(part) for part in parts], "<u4").tobytes() + b"".join(parts)


def _small(z: Cells) -> tuple[Cells, int]:
    """The map thinned to at most _GRID columns, and the stride."""
    factor = max(1, -(-z.shape[1] // _GRID))
    return np.ascontiguousarray(z[::factor, ::factor]), factor


def _coloured(share: Cells) -> Frame:
    grey = np.clip(255 * np.nan_to_num(share, nan=1.0), 0, 255).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS))


def _jpeg(picture: Frame) -> bytes:
    return cv2.imencode(".jpg", picture, _JPEG)[1].tobytes()


def _plain(value: Any) -> Any:
    """The value without NaN and infinities, which JSON lacks."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _handler(live: LiveServer) -> type[http.server.BaseHTTPRequestHandler]:
    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, format: str, *args: Any) -> None:
            """Requests are not news."""

        def do_GET(self) -> None:
            if not self._allowed():
                return
            path, _, query = self.path.partition("?")
            if path == "/":
                self._send(200, "text/html; charset=utf-8", _PAGE.read_bytes())
            elif path == "/next":
                after = query.removeprefix("after=")
                body = live.answer(int(after) if after.isdecimal() else -1)
                self._send(204 if body is None else 200, "application/octet-stream", body or b"")
            elif path == "/snapshot":
                body = live.snapshot()
                self._send(404 if body is None else 200, "application/octet-stream", body or b"")
            else:
                self._send(404, "text/plain", b"no such page")

        def do_POST(self) -> None:
            name = self.path.removeprefix("/")
            if self._allowed() and name in ("pause", "resume", "tare"):
                self._send(200, "text/plain; charset=utf-8", live.command(name).encode())
            else:
                self._send(404, "text/plain", b"no such command")

        def _allowed(self) -> bool:
            """Only pages of this machine: another site's script may not steer or read."""
            host = (self.headers.get("Host") or "").rpartition(":")[0]
            origin = self.headers.get("Origin")
            if host in _HOSTS and (origin is None or origin.rstrip("/") == f"http://{self.headers['Host']}"):
                return True
            self._send(403, "text/plain", b"not from here")
            return False

        def _send(self, code: int, kind: str, body: bytes) -> None:
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            with suppress(ConnectionError):  # the page was closed meanwhile
                self.end_headers()
                self.wfile.write(body)

    return Handler
