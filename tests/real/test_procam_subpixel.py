"""procam_capture_0 within its cells: the blur of the Gray edges tells where a pixel lies between them."""

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, check
from optolever.projector import Capture

from .conftest import LIT, WHITE, monomials

F64 = NDArray[np.float64]


def basis(use: NDArray[np.bool_]) -> F64:
    """Cubic monomials of the scaled positions of the chosen pixels (n, 10)."""
    row, col = (index.astype(np.float64) for index in np.nonzero(use))
    return monomials(row, col)


def place(found: Correspondence, use: NDArray[np.bool_]) -> F64:
    return np.stack([found.u[use], found.v[use]], axis=1).astype(np.float64)


def test_white_squares_below_a_fifth_of_a_pixel(within: Correspondence, light: F64) -> None:
    found = within
    use = (light > WHITE) & found.good
    fit = np.linalg.lstsq(basis(use), place(found, use), rcond=None)[0]
    error = np.hypot(*(place(found, use) - basis(use) @ fit).T)
    assert np.sqrt(np.mean(error**2)) < 0.18
    assert error.max() < 1.0
    lit = (light > LIT) & found.good
    assert np.hypot(*(place(found, lit) - basis(lit) @ fit).T).max() < 2.0


def test_the_lit_board_is_hardly_flagged(within: Correspondence, light: F64) -> None:
    assert within.good[light > LIT].mean() >= 0.95


def test_its_frames_are_in_order_and_a_swap_is_named(procam: Capture) -> None:
    assert check(procam.frames, procam.sequence).findings == ()
    frames = procam.frames.copy()
    frames[[10, 13]] = frames[[13, 10]]
    found = check(frames, procam.sequence).findings
    assert found[0].kind == "swapped"
    assert {10, 13} <= set(found[0].frames)
