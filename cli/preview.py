"""`optolever camera preview`: the camera's picture with the display's reflection, to aim and to focus."""

import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import click

import optolever as ol
from optolever import InputError

from .arguments import ABOVE_0, Opt, Rare, program
from .options import Json
from .rig_devices import Changes, OpenedRig, levels_of, opened
from .show import write_json

SAMPLE = """
$ optolever camera preview --rig rig.toml --text --seconds 2
sees the display  100 %; saturated 0 %; sharpness 100 % of its best. Good. Next: optolever camera expose.
"""

READY = "Good. Next: optolever camera expose."
_WHITE_S = 3.0  # of white between two black pictures
_STALE_S = 0.2  # an image that waited longer is not judged: the newest counts
_GLANCE_S = 5.0
_PERIOD_S = 0.1  # of a virtual camera, which waits for nothing
_WIDTH = 960  # columns of the picture on the page, at most
_WAIT_S = 1.0  # that a request waits for a new picture
_FILES = {"html": "text/html", "js": "text/javascript", "css": "text/css"}

TEXT = Opt("--text", "Print a line a second instead of serving a page.")
SECONDS = Opt("--seconds SECONDS", "Stop after so long; default: Ctrl-C.", ABOVE_0)
PORT = Rare("--port N", "Port of the page, on 127.0.0.1; default: a free one.", click.IntRange(0, 65535))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A picture, what it says about aim and focus, the best sharpness so far."""

    pixels: Any
    bits: int
    aim: "ol.projector.Aim"
    best: float

    def numbers(self) -> dict[str, Any]:
        """For --json and the page."""
        advice = self.aim.advice(self.best)
        return {
            "sees_share": self.aim.seen,
            "saturated_share": self.aim.saturated,
            "sharpness": self.aim.sharpness / self.best if self.best > 0 else 0.0,
            "advice": advice or READY,
            "good": not advice,
        }

    def text(self) -> str:
        """On one line."""
        now = self.numbers()
        sees, saturated, sharp = (
            f"{100 * now[name]:.3g} %" for name in ("sees_share", "saturated_share", "sharpness")
        )
        figures = f"sees the display {sees}; saturated {saturated}; sharpness {sharp} of its best"
        return f"{figures}. {now['advice']}"


@program("preview", SAMPLE)
def command(
    rig: OpenedRig,
    changes: Changes = (),
    text: Annotated[bool, TEXT] = False,
    seconds: Annotated[float | None, SECONDS] = None,
    port: Annotated[int, PORT] = 0,
    json_path: Json = None,
) -> None:
    """Aim and focus a rig's camera.

    The display is white, and black for a moment every three seconds: white less black outlines its reflection
    in the mirror. A sentence says what to turn next. Sharpness has no unit: turn the focus through its best.
    Focus on the mirror, not on the reflection of the display.
    """
    devices = ol.projector.devices_of(rig, changes)
    end = None if seconds is None else time.monotonic() + seconds
    with opened(rig, devices, levels_of(rig, "black", "white")) as now:
        views = _until(views_of(now), end)
        last = _print_lines(views) if text else _serve(views, port)
    if last is None:
        raise InputError("camera: no picture came; is the camera running? (optolever camera devices)")
    write_json(json_path, last.numbers())


def views_of(now: "ol.projector.Opened") -> Iterator[View]:
    """Pictures of the white display without end."""
    arrivals = ol.projector.Arrivals(now.camera, now.time, now.clock, now.triggered, None, now.display)
    timing = ol.projector.Timing(0, 0, 0, 0, 0, 0, 0.01, now.accepted.exposure_s) if now.still else None
    best = 0.0
    while True:
        black, white = (one.image.pixels for one in now.acquire(timing, (0, 1)))
        for image, _ in arrivals.until(now.time.now() + _WHITE_S):
            if not image.complete or now.time.now() - image.arrived_s > _STALE_S:
                continue
            found = ol.projector.aim(image.pixels, white, black, now.accepted.bits)
            best, white = max(best, found.sharpness), image.pixels
            yield View(image.pixels, now.accepted.bits, found, best)
            if now.still:
                now.time.wait(now.time.now() + _PERIOD_S)


def glance(views: Iterator[View]) -> View:
    """The last view of some seconds: of a display that lies over the page."""
    return deque(_until(views, time.monotonic() + _GLANCE_S), maxlen=1).pop()


def still(view: View) -> Iterator[View]:
    """One view again and again."""
    while True:
        yield view
        time.sleep(_PERIOD_S)


def _until(views: Iterator[View], end: float | None) -> Iterator[View]:
    for view in views:
        yield view
        if end is not None and time.monotonic() > end:
            return


def _print_lines(views: Iterator[View]) -> View | None:
    said, last = -1.0, None
    for last in views:
        if time.monotonic() > said + 1:
            click.echo(last.text())
            said = time.monotonic()
    return last


def _serve(views: Iterator[View], port: int) -> View | None:
    """Serve the page while pictures come; the last one."""
    try:
        page = Page(port)
    except OSError as error:
        raise InputError(f"--port {port}: {error.strerror or error}; name another") from error
    last = None
    with page:
        click.echo(f"Preview: {page.address}   (Ctrl-C ends it)")
        for last in views:
            page.show(last)
    return last


class Page:
    """A page that shows the newest view. A context manager; port 0: any free one; OSError if it is taken.

    `GET /next?after=N` waits a second for a view newer than N: its number and figures as JSON; `GET
    /picture` is the newest picture as JPEG, the reflection outlined, saturated pixels red.
    """

    def __init__(self, port: int) -> None:
        from starlette.routing import Route

        routes = [Route("/", self._file), Route("/preview.js", self._file), Route("/preview.css", self._file)]
        routes += [Route("/next", self._next), Route("/picture", self._picture)]
        self._web = ol.live.Web(routes, port)
        self._view: View | None
        self._count, self._view = 0, None
        self._new = threading.Condition()

    @property
    def address(self) -> str:
        """Of the page."""
        return self._web.address

    def __enter__(self) -> "Page":
        self._web.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._web.stop()

    def show(self, view: View) -> None:
        """Let the page draw a view."""
        with self._new:
            self._count, self._view = self._count + 1, view
            self._new.notify_all()

    def _file(self, request: Any) -> Any:
        from starlette.responses import Response

        name = request.url.path.removeprefix("/") or "preview.html"
        text = Path(__file__).with_name(name).read_text(encoding="utf-8")
        return Response(text, media_type=_FILES[name.partition(".")[2]])

    def _next(self, request: Any) -> Any:
        from starlette.responses import JSONResponse

        after = request.query_params.get("after", "0")
        number = int(after) if after.isdecimal() and len(after) < 16 else 0
        with self._new:
            self._new.wait_for(lambda: self._count > number, _WAIT_S)
            count, view = self._count, self._view
        return JSONResponse({"count": count, **(view.numbers() if view is not None else {})})

    def _picture(self, request: Any) -> Any:
        from starlette.responses import Response

        view = self._view
        return Response(b"" if view is None else drawn(view), media_type="image/jpeg")


def drawn(view: View) -> bytes:
    """The picture as JPEG."""
    import cv2
    import numpy as np

    top = 2**view.bits - 1
    levels = np.asarray(view.pixels, np.float32) * (255 / top)
    scale = min(1.0, _WIDTH / levels.shape[1])
    small = cv2.resize(levels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    picture = cv2.cvtColor(np.asarray(np.rint(small), np.uint8), cv2.COLOR_GRAY2BGR)
    full = cv2.resize(np.asarray(view.pixels >= top, np.float32), small.shape[::-1])
    picture[full > 0] = (60, 60, 230)
    lines = [np.asarray(np.rint(one * scale), np.int32)[:, None] for one in view.aim.outline]
    cv2.polylines(picture, lines, True, (80, 200, 60), 2, cv2.LINE_AA)
    return bytes(cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, 85))[1])
