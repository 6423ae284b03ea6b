"""LiveServer: a page on this machine that shows a camera's readings as they come.

`GET /` is the page, `GET /next?after=N` waits for a reading newer than N: the page asks for the next when it
has drawn one, so that nothing queues up. The answer holds four lengths (little-endian uint32), then JSON of
the numbers, two JPEGs (camera, sigma) and the height as float32 in micrometres on a grid whose size is in the
JSON. `POST /pause`, `/resume`, `/tare` steer, with the page's token; `GET /snapshot` is the last reading as
.npz. Pictures are made when somebody asks."""

import asyncio
import io
import json
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route

from .arrays import Cells, Frame
from .follow import Followed, follow, tared
from .prepared import Prepared
from .recorded import ReadingRecorder
from .source import Newest, Source
from .stream import Live
from .web import Web

__all__ = ["LiveServer"]

_PAGE = Path(__file__).with_name("page.html")
_COMMANDS = ("pause", "resume", "tare")
_POLL = 0.005  # s from a reading to whoever waits for it
_TROUBLED = 0.5  # s between the answers of a camera that is gone
_WAIT = 5.0  # s that a request waits for a reading
_DIGITS = 15  # of the number of a reading
_GRID = 96  # columns of the height that is sent, at most
_TARE = 8  # frames
_RECENT = 60  # frames over which the rate is counted
_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 80)


class LiveServer:
    """Reads a source on a thread and serves the page on another. A context manager; port 0: any free one;
    record: gets every reading, which excludes tare."""

    def __init__(
        self, prepared: Prepared, source: Source, port: int = 0, record: ReadingRecorder | None = None
    ) -> None:
        self._record = record
        self._live, self._source = Live(prepared), Newest(source)
        self._lock = threading.Lock()
        self._latest: Followed | None = None
        self._count = 0
        self._times: deque[float] = deque(maxlen=_RECENT)
        self._resting: list[Frame] | None = None
        self._told = ""
        self._error = ""
        self._paused, self._over = False, False
        routes = [
            Route("/", self._page),
            Route("/next", self._next),
            Route("/snapshot", self._snapshot),
            *(Route(f"/{name}", self._steered, methods=["POST"]) for name in _COMMANDS),
        ]
        self._web = Web(routes, port)
        self._thread = threading.Thread(target=self._follow, daemon=True)

    @property
    def address(self) -> str:
        """Of the page."""
        return self._web.address

    @property
    def readings(self) -> int:
        """Number of readings so far."""
        return self._count

    @property
    def error(self) -> str:
        """Why it reads no more; empty while it does."""
        return self._error

    def __enter__(self) -> "LiveServer":
        self._web.start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over = True
        self._web.stop()
        self._thread.join(timeout=5.0)

    def command(self, name: str) -> str:
        """Execute pause, resume or tare; returns the outcome in words. Tare is refused during a contact."""
        with self._lock:
            latest = self._latest
            if name == "pause":
                self._paused, self._told = True, "paused"
            elif name == "resume":
                self._paused, self._told = False, ""
            elif self._record is not None:
                self._told = "tare refused: it would change the rest of the recording"
            elif latest is None or not latest.reading.tareable:
                self._told = "tare refused: something touches, or the frame is not trusted"
            else:
                self._resting, self._told = [], "tare: hold still"
            return self._told

    async def _page(self, request: Request) -> Response:
        return HTMLResponse(_PAGE.read_text(encoding="utf-8").replace("{{token}}", self._web.token))

    async def _next(self, request: Request) -> Response:
        """The reading newer than `after`; 204: none came."""
        after = request.query_params.get("after", "")
        if not after.isdecimal() or len(after) > _DIGITS:
            return PlainTextResponse(f"after: must be a number of at most {_DIGITS} digits", 400)
        end = time.monotonic() + _WAIT
        while not (self._count > int(after) or self._error or self._over or time.monotonic() > end):
            await asyncio.sleep(_POLL)
        if self._error:
            await asyncio.sleep(_TROUBLED)
        with self._lock:
            latest, count, said, error = self._latest, self._count, self._told, self._error
            times = list(self._times)
        if latest is None or (count <= int(after) and not error):
            return Response(status_code=204)
        rate = (len(times) - 1) / max(times[-1] - times[0], 1e-9)
        state = {"count": count, "rate": rate, "told": said or error, "skipped": self._source.skipped}
        return Response(_body(latest, state), media_type="application/octet-stream")

    async def _snapshot(self, request: Request) -> Response:
        """The last reading and its frame as .npz."""
        latest = self._latest
        if latest is None:
            return PlainTextResponse("no reading yet", 404)
        reading, stream = latest.reading, io.BytesIO()
        maps = {name: getattr(reading, name) for name in ("x", "y", "z", "sigma", "good")}
        np.savez(stream, frame=latest.image.pixels, numbers=json.dumps(_plain(latest.to_dict())), **maps)
        return Response(stream.getvalue(), media_type="application/octet-stream")

    async def _steered(self, request: Request) -> Response:
        return PlainTextResponse(self.command(request.url.path.removeprefix("/")))

    def _follow(self) -> None:
        try:
            with self._source as source:
                for followed in follow(self._live, source):
                    if self._over:
                        return
                    self._take(followed)
        except Exception as error:  # the page says it
            self._error = str(error)

    def _take(self, followed: Followed) -> None:
        if self._record is not None:
            self._record.write(followed)
        with self._lock:
            if self._resting is not None:
                self._resting.append(followed.image.pixels)
                if not followed.reading.tareable:
                    self._resting, self._told = None, "tare refused: it was touched meanwhile"
                elif len(self._resting) >= _TARE:
                    self._live.prepared = tared(self._live.prepared, np.stack(self._resting))
                    self._live.reset()
                    self._resting, self._told = None, "tared"
            if not self._paused:
                self._latest, self._count = followed, self._count + 1
                self._times.append(time.monotonic())


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
