"""Crops of real captures that a plain decoder reads: whatever it has right must be good here, too.

The truth is the plain decoder's own place, smoothed: on a flat screen, a flat board or flat paper by the map
of a plane (a cubic polynomial holds both lenses' distortion), on an object by the median of 5 x 5 pixels.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from optolever.decode import Correspondence, decode
from optolever.projector import Capture

from .conftest import monomials
from .plain import Plain, plain_decoder

F64 = NDArray[np.float64]
#: Captures and the axes that they encode.
CASES = {
    "zeng_left_crop": "uv",
    "lijian_skull_crop": "u",
    "lijian_phase_gray_no_white": "u",
    "slstudio_skull_gray": "u",
    "visualma_CasaV2": "uv",
    "visualma_V1": "uv",
    "yeti_mug_edge": "uv",
}
FLAT = ("zeng_left_crop", "lijian_phase_gray_no_white")
KAMINO = "kamino_gamma_3step_gray64px"


class Decoded(NamedTuple):
    capture: Capture
    found: Correspondence


@pytest.fixture(scope="module")
def decoded(real: Path) -> dict[str, Decoded]:
    folder = real / "refused"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: no captures to test with")
    names = sorted({*CASES, KAMINO})
    captures = {name: Capture.load(folder / name) for name in names}
    return {name: Decoded(one, decode(one.frames, one.sequence)) for name, one in captures.items()}


def of_axis(found: Correspondence, axis: str) -> tuple[F64, F64]:
    """Place and sigma, pattern px."""
    place, sigma = (found.u, found.sigma_u) if axis == "u" else (found.v, found.sigma_v)
    return place.astype(np.float64), sigma.astype(np.float64)


def plane(place: F64, use: NDArray[np.bool_]) -> F64:
    """Cubic map (H, W) through the places of most of the pixels to use."""
    row, col = np.mgrid[: place.shape[0], : place.shape[1]].astype(np.float64)
    basis = monomials(row, col)
    fit = np.linalg.lstsq(basis[use], place[use], rcond=None)[0]
    for _ in range(8):
        off = np.abs(place - basis @ fit)
        use = use & (off <= 3 * np.median(off[use]) + 1e-3)
        fit = np.linalg.lstsq(basis[use], place[use], rcond=None)[0]
    return basis @ fit


def truth_of(name: str, plain: Plain) -> F64:
    if name in FLAT:
        return plane(plain.place, np.ones(plain.place.shape, np.bool_))
    return np.asarray(median_filter(plain.place, 5))


def lit(capture: Capture) -> NDArray[np.bool_]:
    """Pixels (H, W) of a seventh of the bright ones' contrast or more."""
    span = np.ptp(np.asarray(capture.frames, np.float64), axis=0)
    return np.asarray(span > 0.15 * np.quantile(span, 0.95))


@pytest.mark.parametrize("name", CASES)
def test_what_a_plain_decoder_has_right_is_good(name: str, decoded: dict[str, Decoded]) -> None:
    """Right on all axes; the place lies between that of the plain decoder and the smooth one."""
    capture, found = decoded[name]
    plains = [plain_decoder(np.asarray(capture.frames), capture.sequence, axis) for axis in CASES[name]]
    truths = [truth_of(name, plain) for plain in plains]
    near = [np.abs(one.place - truth) < 2 * one.cell for one, truth in zip(plains, truths, strict=True)]
    right = lit(capture) & np.all(near, axis=0)
    assert right.mean() > 0.5
    assert found.good[right].mean() >= 0.9
    use = found.good & right
    for axis, plain, truth in zip(CASES[name], plains, truths, strict=True):
        place, sigma = of_axis(found, axis)
        low, high = np.minimum(truth, plain.place), np.maximum(truth, plain.place)
        error = np.abs(place - np.clip(place, low, high))[use]
        assert (error > np.maximum(5 * sigma[use], plain.cell)).mean() <= 5e-3
        assert np.median(sigma[use]) <= 3 * plain.cell


def by_edges(capture: Capture, axis: str) -> F64:
    """Polynomial map (H, W) through the edges of the Gray code's cells between pixels side by side, which are
    known to half a pixel each; NaN beyond the outermost ones. Cubic, or of as many orders as edges tell."""
    cells = plain_decoder(np.asarray(capture.frames)[6:], capture.sequence[6:], axis)
    down = "uv".index(axis)  # edges of v lie between rows
    place = cells.place if axis == "u" else cells.place.T
    row, col = np.mgrid[: place.shape[0], : place.shape[1] - 1].astype(np.float64)
    edge = np.abs(np.diff(place, axis=1)) == cells.cell
    at = 0.5 * (place[:, 1:] + place[:, :-1])[edge]
    order = min(3, len(np.unique(at)) - 1)
    known = monomials(row[edge], col[edge] + 0.5, order)
    fit = np.linalg.lstsq(known, at, rcond=None)[0]
    assert np.std(at - known @ fit) < 2
    whole = monomials(*np.mgrid[: place.shape[0], : place.shape[1]].astype(np.float64), order) @ fit
    whole[(whole < at.min()) | (whole > at.max())] = np.nan
    return np.asarray(whole.T if down else whole)


@pytest.mark.parametrize("axis", "uv")
def test_sigma_holds_what_three_steps_hide_of_a_gamma(axis: str, decoded: dict[str, Decoded]) -> None:
    capture, found = decoded[KAMINO]
    (place, sigma), truth = of_axis(found, axis), by_edges(capture, axis)
    use = found.good & np.isfinite(truth)
    assert use.any()
    assert (np.abs(place - truth)[use] > np.maximum(5 * sigma[use], 2.0)).mean() <= 1e-3
