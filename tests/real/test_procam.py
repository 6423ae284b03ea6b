"""procam_capture_0: a Gray-coded projector on a flat chessboard.

The board is a plane, so on its white squares the map from camera to projector is a homography, up to the
distortion of both lenses: a cubic polynomial stands for both. Rounding alone costs sqrt(2/12) = 0.408 px.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.cli import run
from optolever.decode import decode, explain
from optolever.projector import Capture

from .conftest import DESCRIPTION, GROSS, LIT, WHITE, monomials

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


def test_white_squares_fit_a_plane(decoded: dict[str, NDArray[np.generic]], light: Floats) -> None:
    use = (light > WHITE) & (decoded["flags"] == 0)
    assert use.sum() > 0.95 * (light > WHITE).sum()
    row, col = (index.astype(np.float64) for index in np.nonzero(use))
    place = np.stack([decoded["u"][use], decoded["v"][use]], axis=1).astype(np.float64)
    cubic = misfit_cubic(row, col, place)
    assert np.sqrt(np.mean(cubic**2)) <= 0.42


@pytest.mark.parametrize("inverses", [True, False])
def test_the_lit_board_is_good_and_nowhere_grossly_wrong(
    inverses: bool, procam: Capture, light: Floats
) -> None:
    """Beside a cubic map through the words of the bits on the white squares, which knows nothing of the
    decoder. A weak bit costs resolution, which sigma holds, and not the pixel."""
    keep = [i for i, frame in enumerate(procam.sequence.frames) if inverses or not frame.inverted]
    shown = replace(procam.sequence, frames=tuple(procam.sequence.frames[i] for i in keep))
    found, lit = decode(procam.frames[keep], shown), light > LIT
    assert found.good[lit].mean() >= 0.95
    use, off = lit & found.good, []
    basis = monomials(*np.mgrid[: light.shape[0], : light.shape[1]].astype(np.float64))
    for place, first in ((found.u, 0), (found.v, 20)):
        bits = procam.frames[first : first + 20 : 2] > procam.frames[first + 1 : first + 21 : 2]
        cells = np.tensordot(2.0 ** np.arange(10)[::-1], np.logical_xor.accumulate(bits), 1)
        white = light > WHITE
        for _ in range(3):
            fit = np.linalg.lstsq(basis[white], cells[white], rcond=None)[0]
            white = (light > WHITE) & (np.abs(cells - basis @ fit) < 2)
        assert np.std((cells - basis @ fit)[white]) < 0.36  # rounding alone: 0.29
        off.append((place - basis @ fit)[use])
    assert (np.hypot(*off) <= np.maximum(GROSS, 5 * np.hypot(found.sigma_u, found.sigma_v)[use])).all()


def test_a_swap_makes_nothing_wrong_and_is_explained(procam: Capture) -> None:
    """Coarse bits: read as they come, they lead a quarter of the projector away."""
    frames = procam.frames.copy()
    frames[[2, 6]] = frames[[6, 2]]
    whole, found = decode(procam.frames, procam.sequence), decode(frames, procam.sequence)
    both = found.good & whole.good
    off = np.abs(found.u - whole.u)[both] > np.maximum(1, 5 * found.sigma_u[both])
    assert off.mean() < 0.02 or found.notices
    first = explain(frames, procam.sequence)[0]
    assert first.name == "frames 2 and 6 are in each other's place"
    assert first.sequence is not None
    mended = decode(frames[list(first.pictures)], first.sequence)
    assert np.array_equal(mended.flags, whole.flags)
