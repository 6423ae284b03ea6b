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
from optolever.decode import decode
from optolever.projector import Capture

from .conftest import DESCRIPTION, LIT, WHITE, monomials

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@pytest.fixture(scope="module")
def decoded(real: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, NDArray[np.generic]]:
    """The correspondence, through the command line."""
    out = tmp_path_factory.mktemp("procam") / "c.npz"
    folder = real / "procam_capture_0"
    assert run(["decode", str(folder), "--description", str(DESCRIPTION), "--out", str(out)]) == 0
    with np.load(out) as archive:
        return {name: archive[name] for name in archive.files}


def misfit_cubic(row: Floats, col: Floats, place: Floats) -> Floats:
    """Distance (n,) in projector pixels of places (n, 2) from the best cubic map."""
    basis = monomials(row, col)
    return np.hypot(*(place - basis @ np.linalg.lstsq(basis, place, rcond=None)[0]).T)


def misfit_homography(row: Floats, col: Floats, place: Floats) -> Floats:
    """Distance (n,) in projector pixels of places (n, 2) from the best homography."""
    matrix, _ = cv2.findHomography(np.stack([col, row], axis=1), place)
    mapped = np.stack([col, row, np.ones_like(col)], axis=1) @ matrix.T
    return np.hypot(*(place - mapped[:, :2] / mapped[:, 2:]).T)


def test_black_squares_are_the_share_that_the_readme_tells(light: Floats, sheet: Mask) -> None:
    """So the outline taken here is the one meant there."""
    assert (light[sheet] <= LIT).mean() == pytest.approx(0.38, abs=0.02)


def test_white_squares_fit_a_plane(decoded: dict[str, NDArray[np.generic]], light: Floats) -> None:
    use = (light > WHITE) & (decoded["flags"] == 0)
    assert use.sum() > 0.95 * (light > WHITE).sum()
    row, col = (index.astype(np.float64) for index in np.nonzero(use))
    place = np.stack([decoded["u"][use], decoded["v"][use]], axis=1).astype(np.float64)
    cubic = misfit_cubic(row, col, place)
    assert np.sqrt(np.mean(cubic**2)) <= 0.42
    assert np.sqrt(np.mean(misfit_homography(row, col, place) ** 2)) <= 0.5


def test_a_swap_is_named_and_repaired(procam: Capture, light: Floats) -> None:
    """Coarse bits: read as they come, they lead a quarter of the projector away."""
    frames, lit = procam.frames.copy(), light > LIT
    frames[[2, 6]] = frames[[6, 2]]
    whole, found = decode(procam.frames, procam.sequence), decode(frames, procam.sequence)
    assert [one for one in found.notices if "2 and 6 are in each other's place" in one.name]
    assert found.good[lit].mean() > 0.95 * whole.good[lit].mean()
    both = found.good & whole.good
    assert np.mean(np.abs(found.u - whole.u)[both] > np.maximum(1, 5 * found.sigma_u[both])) < 1e-3
