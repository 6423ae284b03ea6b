"""procam_capture_0: a Gray-coded projector on a flat chessboard.

The board is a plane, so on its white squares the map from camera to projector is a homography, up to the
distortion of both lenses, for which a cubic polynomial stands. Rounding alone costs sqrt(2/12) = 0.408 px.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.cli import run

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

DESCRIPTION = Path(__file__).with_name("procam_capture_0.toml")
# Corners of the printed squares in the camera image (column, row), clockwise from the top left.
BOARD = np.array([[256, 205], [954, 205], [955, 763], [244, 762]], np.float64)
MARGIN = 1.06  # the sheet around them: so much of it that black squares are 38 % of it
LIT = 20  # white minus black, levels
WHITE = 60  # between the black squares' 9 to 40 and the white squares' 85 to 135
GROSS = 2.0  # px


@pytest.fixture(scope="module")
def decoded(real: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, NDArray[np.generic]]:
    """The correspondence, through the command line."""
    out = tmp_path_factory.mktemp("procam") / "c.npz"
    folder = real / "procam_capture_0"
    assert run(["decode", str(folder), "--description", str(DESCRIPTION), "--out", str(out)]) == 0
    with np.load(out) as archive:
        return {name: archive[name] for name in archive.files}


@pytest.fixture(scope="module")
def light(real: Path) -> NDArray[np.int64]:
    """White minus black frame, levels."""
    white, black = (
        cv2.imread(str(real / f"procam_capture_0/graycode_{number}.png"), cv2.IMREAD_GRAYSCALE)
        for number in (40, 41)
    )
    return white.astype(np.int64) - black


@pytest.fixture(scope="module")
def sheet(light: NDArray[np.int64]) -> Mask:
    """Pixels of the printed sheet."""
    centre = BOARD.mean(axis=0)
    corners = np.round(centre + MARGIN * (BOARD - centre)).astype(np.int32)
    mask = np.zeros(light.shape, np.uint8)
    cv2.fillPoly(mask, [corners], 1)
    return mask.astype(bool)


def polynomial(row: Floats, col: Floats, order: int) -> Floats:
    """Monomials of the scaled pixel position up to the order, (n, terms)."""
    x, y = col / 640 - 1, row / 512 - 1
    return np.stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)], axis=1)


def misfit_cubic(row: Floats, col: Floats, place: Floats) -> Floats:
    """Distance (n,) in projector pixels of places (n, 2) from the best cubic map."""
    basis = polynomial(row, col, 3)
    return np.hypot(*(place - basis @ np.linalg.lstsq(basis, place, rcond=None)[0]).T)


def misfit_homography(row: Floats, col: Floats, place: Floats) -> Floats:
    """Distance (n,) in projector pixels of places (n, 2) from the best homography."""
    matrix, _ = cv2.findHomography(np.stack([col, row], axis=1), place)
    mapped = np.stack([col, row, np.ones_like(col)], axis=1) @ matrix.T
    return np.hypot(*(place - mapped[:, :2] / mapped[:, 2:]).T)


def test_black_squares_are_the_share_that_the_readme_tells(light: NDArray[np.int64], sheet: Mask) -> None:
    """So the outline taken here is the one meant there."""
    assert (light[sheet] <= LIT).mean() == pytest.approx(0.38, abs=0.02)


def test_white_squares_fit_a_plane(
    decoded: dict[str, NDArray[np.generic]], light: NDArray[np.int64], sheet: Mask
) -> None:
    use = sheet & (light > WHITE) & (decoded["flags"] == 0)
    assert use.sum() > 0.95 * (sheet & (light > WHITE)).sum()
    row, col = (index.astype(np.float64) for index in np.nonzero(use))
    place = np.stack([decoded["u"][use], decoded["v"][use]], axis=1).astype(np.float64)
    cubic = misfit_cubic(row, col, place)
    assert np.sqrt(np.mean(cubic**2)) <= 0.42
    assert np.sqrt(np.mean(misfit_homography(row, col, place) ** 2)) <= 0.5


def test_no_unflagged_pixel_of_the_lit_board_is_grossly_wrong(
    decoded: dict[str, NDArray[np.generic]], light: NDArray[np.int64], sheet: Mask
) -> None:
    white = sheet & (light > WHITE) & (decoded["flags"] == 0)
    use = sheet & (light > LIT) & (decoded["flags"] == 0)
    assert use.sum() > 0.5 * (sheet & (light > LIT)).sum()
    row, col = (index.astype(np.float64) for index in np.nonzero(white))
    fit = np.linalg.lstsq(
        polynomial(row, col, 3), np.stack([decoded["u"][white], decoded["v"][white]], axis=1), rcond=None
    )[0]
    row, col = (index.astype(np.float64) for index in np.nonzero(use))
    place = np.stack([decoded["u"][use], decoded["v"][use]], axis=1)
    assert np.hypot(*(place - polynomial(row, col, 3) @ fit).T).max() < GROSS
