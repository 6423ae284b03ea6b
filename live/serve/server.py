"""LiveServer: a page on this machine that shows a camera's readings as they come.

`GET /` is the page, `GET /next?after=N&trace=raw` (or steady, difference: of the spectra) waits for a
reading newer than N: the page asks for the next when it
has drawn one, so that nothing queues up. The answer holds four lengths (little-endian uint32), then JSON of
the numbers, the camera's picture as JPEG, sigma and height as float32 in micrometres on a grid whose size is
in the JSON. `POST /tare`, `/record`, `/probe?at=ROW,COL` (shares of the map) and `/clear?probe=N` (0: all)
steer, with the page's token; `GET /snapshot` is the last reading as .npz. Pictures are made when somebody
asks; a page that pauses asks no more."""

import asyncio
import io
import json
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from optolever.arrays import Cells, Frame
from optolever.errors import InputError
from optolever.files import plain

from ..follow import Followed, follow, tared
from ..probes import TRACES, Probes
from ..recorded import ReadingRecorder
from ..rest.prepared import Prepared
from ..source import Newest, Source
from ..stream import Live
from .web import Web

__all__ = ["LiveServer"]

_COMMANDS = ("tare", "record", "probe", "clear")
_POLL = 0.005  # s from a reading to whoever waits for it
_TROUBLED = 0.5  # s between the answers of a camera that is gone
_WAIT = 1.0  # s that a request waits for a reading
_DIGITS = 15  # of the number of a reading
_GRID = 96  # columns of the height that is sent, at most
_TARE = 8  # frames
_PROBES = 6  # at most
_SPECTRUM = 12.0  # s of a probe's spectrum, made anew every half second
_RECENT = 60  # frames over which the rate is counted
_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 80)


class LiveServer:
    """Reads a source on a thread and serves the page on another. A context manager; port 0: any free one;
    record: folder to record to from the first reading on; probes: of the same rig; heard: gets every
    reading."""

    def __init__(
        self,
        prepared: Prepared,
        source: Source,
        port: int = 0,
        *,
        record: str | Path | None = None,
        probes: Probes | None = None,
        heard: Callable[[Followed], None] | None = None,
    ) -> None:
        self._live, self._source = Live(prepared), Newest(source)
        self._probes, self._heard = probes or Probes(prepared), heard
        self._lock = threading.Lock()
        self._latest: Followed | None = None
        self._count = 0
        self._times: deque[float] = deque(maxlen=_RECENT)
        self._resting: list[Frame] | None = None
        self._spectra: dict[str, tuple[float, list[dict[str, Any] | None]]] = {}
        self._answer, self._error, self._over = "", "", False
        routes = [
            Route("/next", self._next),
            Route("/snapshot", self._snapshot),
            *(Route(f"/{name}", self._steered, methods=["POST"]) for name in _COMMANDS),
        ]
        self._web = Web(routes, port)
        self._begun: ReadingRecorder | None = None
        self._record = None if record is None else ReadingRecorder(record, prepared, "live")
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
    def rate(self) -> float:
        """Readings a second, of the last 60; 0 before the second."""
        with self._lock:
            times = [*self._times]
        return (len(times) - 1) / max(times[-1] - times[0], 1e-9) if times else 0.0

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
        self._stop_recording()

    def command(self, name: str, at: tuple[float, float] = (0.5, 0.5), probe: int = 0) -> str:
        """Execute a command; returns the outcome in words. Tare is refused during a contact. at: row and
        column of a new probe, shares of the map; probe: the one that clear removes, 0 all."""
        with self._lock:
            try:
                self._answer = self._executed(name, at, probe)
            except (InputError, OSError) as error:
                self._answer = str(error)
            return self._answer

    def _executed(self, name: str, at: tuple[float, float], probe: int) -> str:
        latest = self._latest
        if name == "record":
            return self._stop_recording() or self._start_recording()
        if name == "clear":
            del self._probes.each[max(probe - 1, 0) : probe or None]
            self._spectra.clear()
            return ""
        if name == "probe":
            if len(self._probes.each) >= _PROBES:
                return f"{_PROBES} probes are there: clear them first"
            points = self._live.prepared.points
            row, col = (
                min(int(part * size), size - 1) for part, size in zip(at, points.shape[1:], strict=True)
            )
            self._probes.add(*(float(one) for one in points[:2, row, col]))
            return ""
        if self._record is not None:
            return "tare refused: it would change the rest of the recording"
        if latest is None or not latest.reading.tareable:
            return "tare refused: something touches, or the frame is not trusted"
        self._resting = []
        return "tare: hold still"

    def _start_recording(self) -> str:
        """From the next reading on, which does not depend on those before, as a replay begins with it."""
        self._begun = ReadingRecorder(time.strftime("live-%Y%m%d-%H%M%S"), self._live.prepared, "live")
        return f"recording to {self._begun.folder}"

    def _stop_recording(self) -> str:
        """What was recorded; empty: nothing is."""
        if self._record is None:
            return ""
        self._record.close()
        said, self._record = f"{self._record.images} frames recorded in {self._record.folder}", None
        return said

    async def _next(self, request: Request) -> Response:
        """The reading newer than `after`; 204: none came; 503: none will, and why."""
        after = request.query_params.get("after", "")
        if not after.isdecimal() or len(after) > _DIGITS:
            return PlainTextResponse(f"after: must be a number of at most {_DIGITS} digits", 400)
        trace = request.query_params.get("trace", "raw")
        if trace not in TRACES:
            return PlainTextResponse(f"trace: must be one of {', '.join(TRACES)}", 400)
        end = time.monotonic() + _WAIT
        while not (self._count > int(after) or self._error or self._over or time.monotonic() > end):
            await asyncio.sleep(_POLL)
        if self._error:
            await asyncio.sleep(_TROUBLED)
        with self._lock:
            latest, count, said, error = self._latest, self._count, self._answer, self._error
            newest = self._times[-1] if self._times else 0.0
        if latest is None and error:
            return PlainTextResponse(error, 503)
        if latest is None or (count <= int(after) and not error):
            return Response(status_code=204)
        state = {"count": count, "rate": self.rate, "answer": error or said, "skipped": self._source.skipped}
        state |= {"age_s": time.monotonic() - newest, "spectra": self._spectra_now(trace)}
        state |= {"recording": str(self._record.folder) if self._record else "", "error": error}
        body = await asyncio.to_thread(_body, latest, state, self._live.prepared)
        return Response(body, media_type="application/octet-stream")

    def _spectra_now(self, trace: str) -> list[dict[str, Any] | None]:
        """Plain values of the probes' spectra; bins of 1 / duration, nm."""
        if trace not in self._spectra or time.monotonic() > self._spectra[trace][0] + 0.5:
            with self._lock:
                spectra = self._probes.spectra(_SPECTRUM, trace)
            plainly = [None if one is None else one.to_dict() for one in spectra]
            self._spectra[trace] = time.monotonic(), plainly
        return self._spectra[trace][1]

    async def _snapshot(self, request: Request) -> Response:
        """The last reading and its frame as .npz."""
        latest = self._latest
        if latest is None:
            return PlainTextResponse("no reading yet", 404)
        reading, stream = latest.reading, io.BytesIO()
        maps = {name: getattr(reading, name) for name in ("x", "y", "z", "sigma", "good")}
        np.savez(stream, frame=latest.image.pixels, numbers=json.dumps(plain(latest.to_dict())), **maps)
        return Response(stream.getvalue(), media_type="application/octet-stream")

    async def _steered(self, request: Request) -> Response:
        at = re.fullmatch(r"(0\.?\d{0,9}|1),(0\.?\d{0,9}|1)", request.query_params.get("at", "0.5,0.5"))
        if at is None:
            return PlainTextResponse("at: must be two numbers from 0 to 1", 400)
        which = request.query_params.get("probe", "0")
        if re.fullmatch(r"[0-9]", which) is None:
            return PlainTextResponse("probe: must be a digit", 400)
        place = float(at[1]), float(at[2])
        return PlainTextResponse(self.command(request.url.path.removeprefix("/"), place, int(which)))

    def _follow(self) -> None:
        try:
            with self._source as source:
                for followed in follow(self._live, source, probes=self._probes):
                    if self._over:
                        return
                    self._take(followed)
        except Exception as error:  # the page says it
            self._error = str(error)

    def _take(self, followed: Followed) -> None:
        with self._lock:
            if self._record is not None:
                self._record.write(followed)
            if self._resting is not None:
                self._resting.append(followed.image.pixels)
                if not followed.reading.tareable:
                    self._resting, self._answer = None, "tare refused: it was touched meanwhile"
                elif len(self._resting) >= _TARE:
                    self._live.restart(tared(self._live.prepared, np.stack(self._resting)))
                    self._resting, self._answer = None, "tared"
            if self._begun is not None:
                self._live.restart(self._live.prepared)
                self._record, self._begun = self._begun, None
            self._latest, self._count = followed, self._count + 1
            self._times.append(time.monotonic())
        if self._heard is not None:
            self._heard(followed)


def _body(followed: Followed, state: dict[str, Any], prepared: Prepared) -> bytes:
    reading, points = followed.reading, prepared.points
    thin = slice(None, None, max(1, -(-reading.z.shape[1] // _GRID)))
    z = np.where(reading.good, 1e3 * reading.z, np.nan).astype(np.float32)[thin, thin]
    sigma = np.where(reading.good, reading.sigma, np.nan)
    typical = float(np.nanmedian(sigma)) if reading.good.any() else 1e-3
    numbers = followed.to_dict() | state | {"rows": z.shape[0], "cols": z.shape[1]}
    row, col = (size // 2 for size in points.shape[1:])
    x, y = points[0, row, :: max(2 * col - 1, 1)], points[1, :: max(2 * row - 1, 1), col]
    numbers |= {"x": [float(x[0]), float(x[-1])], "y": [float(y[0]), float(y[-1])]}
    marks = [_place(points, one.x, one.y) for one in reading.touches]
    numbers |= {"marks": marks, "places": [_place(points, one.x, one.y) for one in followed.probes]}
    numbers |= {"sigma_um": 1e3 * typical, "lost": reading.figures.lost, "noise": reading.figures.noise}
    numbers |= {"layer": prepared.layer is not None}
    trust = (1e3 * sigma).astype(np.float32)[thin, thin]
    share = followed.image.pixels.astype(np.float32) / prepared.rig.carriers.full
    camera = cv2.imencode(".jpg", np.clip(255 * share, 0, 255).astype(np.uint8), _JPEG)[1]
    parts = [json.dumps(plain(numbers)).encode(), camera.tobytes(), trust.tobytes(), z.tobytes()]
    return np.array([len(part) for part in parts], "<u4").tobytes() + b"".join(parts)


def _place(points: Cells, x: float, y: float) -> tuple[float, float]:
    """Row and column of a point of the mirror, as shares of the map."""
    at = np.unravel_index(int(np.hypot(points[0] - x, points[1] - y).argmin()), points.shape[1:])
    row, col = ((int(one) + 0.5) / size for one, size in zip(at, points.shape[1:], strict=True))
    return row, col
