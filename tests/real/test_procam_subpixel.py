"""procam_capture_0 within its cells: the blur of the Gray edges tells where a pixel lies between them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence, check, decode
from optolever.projector import Capture

DESCRIPTION = Path(__file__).with_name("procam_capture_0.toml")
# As in test_procam: corners of the printed squares (column, row), the sheet around them, levels of light.
BOARD = np.array([[256, 205], [954, 205], [955, 763], [244, 762]], np.float64)
MARGIN, LIT, WHITE = 1.06, 20, 60
F64 = NDArray[np.float64]


@pytest.fixture(scope="module")
def capture(real: Path) -> Capture:
    """The frames and their description."""
    return Capture.load(real / "procam_capture_0", DESCRIPTION)


@pytest.fixture(scope="module")
def found(capture: Capture) -> Correspondence:
    """Decoded within the cells."""
    return decode(capture.frames, capture.sequence, subpixel=True)


@pytest.fixture(scope="module")
def light(capture: Capture) -> NDArray[np.int64]:
    """White minus black frame on the sheet, 0 around it."""
    centre = BOARD.mean(axis=0)
    mask = np.zeros(capture.frames.shape[1:], np.uint8)
    cv2.fillPoly(mask, [np.round(centre + MARGIN * (BOARD - centre)).astype(np.int32)], 1)
    return (capture.frames[40].astype(np.int64) - capture.frames[41]) * mask


def basis(use: NDArray[np.bool_]) -> F64:
    """Cubic monomials of the scaled positions of the chosen pixels (n, 10)."""
    row, col = (index.astype(np.float64) for index in np.nonzero(use))
    x, y = col / 640 - 1, row / 512 - 1
    return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)


def place(found: Correspondence, use: NDArray[np.bool_]) -> F64:
    return np.stack([found.u[use], found.v[use]], axis=1).astype(np.float64)


def test_white_squares_below_a_fifth_of_a_pixel(found: Correspondence, light: NDArray[np.int64]) -> None:
    use = (light > WHITE) & found.good
    fit = np.linalg.lstsq(basis(use), place(found, use), rcond=None)[0]
    error = np.hypot(*(place(found, use) - basis(use) @ fit).T)
    assert np.sqrt(np.mean(error**2)) < 0.18
    assert error.max() < 1.0
    lit = (light > LIT) & found.good
    assert np.hypot(*(place(found, lit) - basis(lit) @ fit).T).max() < 2.0


def test_the_lit_board_is_hardly_flagged(found: Correspondence, light: NDArray[np.int64]) -> None:
    assert found.good[light > LIT].mean() >= 0.95


def test_its_frames_are_in_order_and_a_swap_is_named(capture: Capture) -> None:
    assert check(capture.frames, capture.sequence).findings == ()
    frames = capture.frames.copy()
    frames[[10, 13]] = frames[[13, 10]]
    found = check(frames, capture.sequence).findings
    assert found[0].kind == "swapped"
    assert {10, 13} <= set(found[0].frames)
