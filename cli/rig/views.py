"""Views to aim and to focus by: pictures of the white display, for a page, and for the display itself where
it lies over the page."""

import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import optolever as ol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["DisplayPreview", "View", "drawn", "preview_on", "views_of"]

_WHITE_S = 3.0  # of white between two black pictures
_STALE_S = 0.2  # an image that waited longer is not judged: the newest counts
_PERIOD_S = 0.1  # of a virtual camera, which waits for nothing
_WIDTH = 960  # columns of the picture, at most
_LINES = 26  # of text in the height, or the width, of the display
_CAPITAL = 21.0  # pixels of a capital letter of OpenCV's font at scale 1
_INK, _BAD, _GOOD = (35, 31, 27), (30, 38, 179), (55, 127, 26)  # blue, green, red
_FOCUS = "Focus on the mirror, not on the reflection of the display."
_KEYS = {"enter": "it is aimed and sharp, go on", "escape": "back"}


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A picture, aim and focus measured in it, the best sharpness so far."""

    pixels: Any
    bits: int
    aim: "ol.camera.Aim"
    best: float

    def numbers(self) -> dict[str, Any]:
        """For the page."""
        advice = self.aim.advice(self.best)
        return {
            "sees_share": self.aim.seen,
            "saturated_share": self.aim.saturated,
            "sharpness": self.aim.sharpness / self.best if self.best > 0 else 0.0,
            "advice": advice or "Good.",
            "good": not advice,
        }

    def figures(self) -> str:
        """On one line."""
        names = ("sees_share", "saturated_share", "sharpness")
        sees, saturated, sharp = (f"{100 * self.numbers()[name]:.3g} %" for name in names)
        return f"sees the display {sees}; saturated {saturated}; sharpness {sharp} of its best"


@dataclass
class DisplayPreview:
    """The display as a sheet of paper: advice, picture, keys. key: the one that was pressed, of `_KEYS`."""

    display: "ol.projector.PatternWindow"
    rows: int
    cols: int
    key: str = ""

    def show(self, view: View) -> None:
        """Draw a view, and look for keys."""
        self._draw(_paper(view, self.rows, self.cols))

    def caption(self, text: str, seen: "ol.decode.Correspondence") -> None:
        """A text over the pattern in the outer half of the widest margin beyond the camera's view; looks for
        keys, too; no text where that is too narrow. seen: the correspondence at rest."""
        import numpy as np

        (left, right), (above, below) = (
            (each[seen.good].min(), each[seen.good].max()) for each in (seen.u, seen.v)
        )
        margins = [above, self.rows - below, left, self.cols - right]
        line, side = _line(self.rows, self.cols), int(np.argmax(margins))
        if (thick := int(margins[side] / 2)) < 1.5 * line:
            return
        strip = np.zeros(
            (*((min(thick, 2 * line), self.cols) if side < 2 else (self.rows, thick)), 3), np.uint8
        )
        _write(strip, line, text, 1.2, (255, 255, 255), 0)
        at = (self.rows - strip.shape[0]) * (side == 1), (self.cols - strip.shape[1]) * (side == 3)
        self._draw(strip, at, self.display.index)

    def _draw(
        self, picture: "NDArray[np.uint8]", at: tuple[int, int] = (0, 0), over: int | None = None
    ) -> None:
        pressed = self.display.picture(_jpeg(picture), at, over)
        self.key = next((each for each in pressed if each in _KEYS), "")


def preview_on(display: "ol.projector.Display", scene: "ol.scene.Scene", name: str) -> DisplayPreview | None:
    """The preview on the display of that name where it is the only one; None: another has the page, or there
    is no window."""
    if not isinstance(display, ol.projector.PatternWindow):
        return None
    if name == "window" or len(ol.projector.monitors()) > 1:
        return None
    return DisplayPreview(display, scene.pattern.rows, scene.pattern.cols)


def views_of(now: "ol.camera.Opened", sheet: DisplayPreview | None = None) -> Iterator[View]:
    """Pictures of the white display without end; on a sheet until a key: there a view is judged by its flash
    of white alone."""
    timing = ol.camera.Timing(0, 0, 0, 0, 0, 0, 0.01, now.accepted.exposure_s) if now.still else None
    arrivals, best = now.arrivals(), 0.0
    while True:
        black, white = (one.image.pixels for one in now.acquire(timing, (0, 1)))
        found: ol.camera.Aim | None = None
        for image, _ in arrivals.until(now.time.now() + _WHITE_S):
            if not image.complete or now.time.now() - image.arrived_s > _STALE_S:
                continue
            if found is None or sheet is None:
                found = ol.camera.aim(image.pixels, white, black, now.accepted.bits)
                best, white = max(best, found.sharpness), image.pixels
            view = View(image.pixels, now.accepted.bits, found, best)
            if sheet is not None:
                sheet.show(view)
            yield view
            if sheet is not None and sheet.key:
                return
            if now.still:
                now.time.wait(now.time.now() + _PERIOD_S)


def drawn(view: View) -> bytes:
    """The picture as JPEG, the reflection outlined, saturated pixels red."""
    return _jpeg(_picture(view, _WIDTH / view.pixels.shape[1]))


def _paper(view: View, rows: int, cols: int) -> "NDArray[np.uint8]":
    """White paper (rows, cols, 3) with advice, figures, picture and keys."""
    import numpy as np

    paper, line, numbers = np.full((rows, cols, 3), 255, np.uint8), _line(rows, cols), view.numbers()

    top = _write(paper, line, numbers["advice"], 1.5, _GOOD if numbers["good"] else _BAD, 0)
    top = _write(paper, line, view.figures(), 1.0, _INK, top)
    below = rows - 3 * line - line * (rows > cols)
    scale = min((below - top - line) / view.pixels.shape[0], (cols - 2 * line) / view.pixels.shape[1])
    if scale > 0.02:
        picture = _picture(view, scale, larger=True)
        paper[top + line // 2 :, line:][: picture.shape[0], : picture.shape[1]] = picture
    keys = "   ".join(f"{key.capitalize()}: {word}." for key, word in _KEYS.items())
    _write(paper, line, keys, 1.0, _INK, _write(paper, line, _FOCUS, 1.0, _INK, below))
    return paper


def _line(rows: int, cols: int) -> int:
    """Height of a line of text, pixels."""
    return max(min(rows, cols) // _LINES, 10)


def _write(
    paper: "NDArray[np.uint8]", line: int, text: str, size: float, colour: tuple[int, int, int], top: int
) -> int:
    """Lines of text below `top`; where they end."""
    import cv2

    scale, font = size * 0.5 * line / _CAPITAL, cv2.FONT_HERSHEY_SIMPLEX
    (wide, _), _ = cv2.getTextSize("n" * 20, font, scale, 1)
    for part in textwrap.wrap(text.replace("±", "+-"), max(20 * (paper.shape[1] - 2 * line) // wide, 8)):
        top += round(size * line)
        place, thick = (line, top - round(0.3 * size * line)), max(round(1.6 * scale), 1)
        cv2.putText(paper, part, place, font, scale, colour, thick, cv2.LINE_AA)
    return top


def _picture(view: View, scale: float, larger: bool = False) -> "NDArray[np.uint8]":
    """Blue, green, red (h, w, 3); larger: beyond its own size, too."""
    import cv2
    import numpy as np

    top, scale = 2**view.bits - 1, scale if larger else min(1.0, scale)
    levels = np.asarray(view.pixels, np.float32) * (255 / top)
    kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    small = cv2.resize(levels, None, fx=scale, fy=scale, interpolation=kind)
    picture = np.asarray(cv2.cvtColor(np.asarray(np.rint(small), np.uint8), cv2.COLOR_GRAY2BGR), np.uint8)
    full = cv2.resize(np.asarray(view.pixels >= top, np.float32), small.shape[::-1])
    picture[full > 0] = (60, 60, 230)
    lines = [np.asarray(np.rint(one * scale), np.int32)[:, None] for one in view.aim.outline]
    cv2.polylines(picture, lines, True, (80, 200, 60), 2, cv2.LINE_AA)
    return picture


def _jpeg(picture: "NDArray[np.uint8]") -> bytes:
    import cv2

    return bytes(cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, 85))[1])
