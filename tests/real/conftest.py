"""procam_capture_0: a Gray-coded projector on a flat chessboard; its frames, sheet and light."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.projector import Capture

F64 = NDArray[np.float64]

DESCRIPTION = Path(__file__).with_name("procam_capture_0.toml")
# Corners of the printed squares in the camera image (column, row), clockwise from the top left.
BOARD = np.array([[256, 205], [954, 205], [955, 763], [244, 762]], np.float64)
MARGIN = 1.06  # the sheet around them: so much of it that black squares are 38 % of it
LIT = 20  # white minus black, levels
WHITE = 60  # between the black squares' 9 to 40 and the white squares' 85 to 135
GROSS = 2.0  # projector px


def monomials(row: F64, col: F64, order: int = 3) -> F64:
    """Those of the scaled pixel positions up to an order, (..., terms)."""
    x, y = col / 640 - 1, row / 512 - 1
    return np.stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)], axis=-1)


@pytest.fixture(scope="session")
def procam(real: Path) -> Capture:
    """The frames and their description."""
    return Capture.load(real / "procam_capture_0", DESCRIPTION)


@pytest.fixture(scope="session")
def sheet(procam: Capture) -> NDArray[np.bool_]:
    """Pixels of the printed sheet."""
    centre = BOARD.mean(axis=0)
    corners = np.round(centre + MARGIN * (BOARD - centre)).astype(np.int32)
    mask = np.zeros(procam.frames.shape[1:], np.uint8)
    cv2.fillPoly(mask, [corners], 1)
    return mask.astype(bool)


@pytest.fixture(scope="session")
def light(procam: Capture, sheet: NDArray[np.bool_]) -> F64:
    """White minus black frame on the sheet, levels; 0 around it."""
    return (procam.frames[40].astype(np.float64) - procam.frames[41]) * sheet
