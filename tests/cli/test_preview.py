"""The step of `optolever start` that aims: the page's answers, the display as a sheet."""

import json
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from optolever.camera import aim
from optolever.cli.rig.start_page import Interviewer
from optolever.cli.rig.views import DisplayPreview, View

from .chromium import asked


@pytest.fixture
def view() -> View:
    """A display on the left half, a patch of it saturated."""
    white = np.full((120, 160), 20, np.uint8)
    white[:, :80] = 200
    white[50:70, 20:40] = 255
    return View(white, 8, aim(white, white, np.full_like(white, 20), 8), 1.0)


def test_the_page_outlines_the_reflection_and_marks_saturated_pixels(view: View) -> None:
    with Interviewer({"aim": "Aim"}, 0, "optolever start") as page:
        before = json.loads(asked(page.address, "/state?after=-1")[1])
        assert before["form"] is None
        seen = list[dict[str, Any]]()

        def views() -> Iterator[View]:
            for _ in range(2):  # the page shows a view before it asks for the next
                yield view
                seen.append(json.loads(asked(page.address, "/state?after=0")[1]))

        assert page.look(views()) is view
        now = seen[-1]["aim"]
        assert (seen[-1]["form"]["kind"], now["good"]) == ("look", False)
        assert now["sees_share"] == pytest.approx(0.5, abs=0.02)
        jpeg = np.frombuffer(asked(page.address, "/picture?1")[1], np.uint8)
        blue, green, red = cv2.imdecode(jpeg, cv2.IMREAD_COLOR).astype(float).transpose(2, 0, 1)
        assert (red - blue)[55:65, 25:35].min() > 100
        assert (green - red)[30:90, 78:82].max() > 60
        title = b"<title>optolever start"
        for path, kind in (("/", title), ("/start.js", b"use strict"), ("/start.css", b"color")):
            status, text = asked(page.address, path)
            assert (status, kind in text) == (200, True)
        assert asked(page.address, "/", Host="elsewhere.example:80")[0] == 403
        assert asked(page.address, "/state?after=" + 5000 * "9")[0] == 200


class Display:
    """Of pictures: levels, place, frame below."""

    index = 7

    def __init__(self) -> None:
        self.drawn: list[tuple[np.ndarray, tuple[int, int], int | None]] = []

    def picture(self, jpeg: bytes, at: tuple[int, int], over: int | None) -> list[str]:
        levels = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).astype(int)
        self.drawn.append((levels, at, over))
        return ["k", "enter"]


@pytest.mark.parametrize("size", [(1080, 1920), (1920, 1080), (480, 640), (200, 320)])
def test_the_display_as_a_sheet_has_picture_text_and_a_white_edge(view: View, size: tuple[int, int]) -> None:
    """All lines of text end within the display, and none runs into the picture."""
    display = Display()
    sheet = DisplayPreview(display, *size)  # type: ignore[arg-type]
    sheet.show(view)
    assert sheet.key == "enter"
    ((paper, _, over),) = display.drawn
    assert over is None
    assert paper.shape[:2] == size
    assert min(edge.min() for edge in (paper[-3:], paper[:, :3], paper[:, -3:])) > 230
    green = np.argwhere((paper[..., 1] - paper[..., 2] > 60) & (paper[..., 1] > 150))
    (top, left), (bottom, right) = green.min(axis=0), green.max(axis=0)
    assert bottom - top > 0.3 * min(size)  # the outlined half of the picture
    assert (right - left) / (bottom - top) == pytest.approx(80 / 120, rel=0.1)
    for text in (paper[: top - 5], paper[bottom + 8 :]):
        assert text.min() < 120


@pytest.mark.parametrize("side", ["top", "bottom", "left", "right", "none"])
def test_a_caption_lies_in_the_margin_that_the_camera_does_not_see(side: str) -> None:
    rows, cols = 480, 640
    box = {"top": 20, "bottom": rows - 20, "left": 20, "right": cols - 20}
    box |= {} if side == "none" else {side: abs(box[side] - 120)}
    v, u = np.mgrid[box["top"] : box["bottom"] : 9j, box["left"] : box["right"] : 9j]
    display = Display()
    sheet = DisplayPreview(display, rows, cols)  # type: ignore[arg-type]
    sheet.caption("depth 100 ± 3 um.", SimpleNamespace(u=u, v=v, good=np.ones(u.shape, bool)))  # type: ignore[arg-type]
    if side == "none":
        assert not display.drawn
        return
    ((strip, (row, col), over),) = display.drawn
    assert over == 7  # the fringe, which stays on
    assert (strip > 200).any()
    covered = np.zeros((rows, cols), bool)
    covered[row : row + strip.shape[0], col : col + strip.shape[1]] = True
    assert covered.sum() == strip[..., 0].size
    assert not (covered & _around(box, side, rows, cols)).any()


def _around(box: dict[str, int], side: str, rows: int, cols: int) -> np.ndarray:
    """Pixels that the camera sees, and 50 beyond on that side."""
    near = box | {side: box[side] + (50 if side in ("bottom", "right") else -50)}
    seen = np.zeros((rows, cols), bool)
    seen[near["top"] : near["bottom"], near["left"] : near["right"]] = True
    return seen
