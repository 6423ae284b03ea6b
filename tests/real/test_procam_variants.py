"""procam_capture_0 as others would hand it in: without inverses, as JPEG, cropped.

The truth is made here, from the whole capture: bits by comparing with their inverses, a cubic map fitted to
the white squares without those far from it. It knows nothing of the decoder.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode
from optolever.patterns import Sequence
from optolever.projector import Capture

from .conftest import GROSS, LIT, WHITE, monomials

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

GROSS_JPEG = 3.0  # projector px
GOOD = 0.95
EVERY_DAY = ("whole", "no inverses", "cropped")
RARER = ("jpeg", "no inverses jpeg")
VARIANTS = [*EVERY_DAY, *(pytest.param(name, marks=pytest.mark.slow) for name in RARER)]
CROP = (slice(300, 700), slice(350, 850))  # inside the sheet and around no edge of the board


@dataclass(frozen=True)
class Variant:
    """Frames, and per pixel (H, W): where it looks by the cubic map, light of the projector on the sheet."""

    frames: NDArray[np.uint8]
    sequence: Sequence
    u: F64
    v: F64
    light: F64

    @property
    def lit(self) -> Mask:
        return self.light > LIT


def word(frames: NDArray[np.uint8], first: int) -> F64:
    """Cells of ten Gray bits from frame `first` on, each followed by its inverse, most significant first."""
    bits = frames[first : first + 20 : 2] > frames[first + 1 : first + 21 : 2]
    return sum(bit.astype(np.float64) * 2 ** (9 - k) for k, bit in enumerate(np.logical_xor.accumulate(bits)))


@pytest.fixture(scope="module")
def whole(procam: Capture, light: F64) -> Variant:
    """The capture as it is, with its truth."""
    frames = np.asarray(procam.frames)
    row, col = np.mgrid[: light.shape[0], : light.shape[1]].astype(np.float64)
    every, maps = monomials(row, col), []
    for cells in (word(frames, 0), word(frames, 20)):
        use = light > WHITE
        for _ in range(3):
            fit = np.linalg.lstsq(every[use], cells[use], rcond=None)[0]
            use = (light > WHITE) & (np.abs(cells - every @ fit) < 2)
        assert use.sum() > 0.97 * (light > WHITE).sum()
        assert np.std((cells - every @ fit)[use]) < 0.36  # rounding alone: 0.29
        maps.append(every @ fit)
    return Variant(frames, procam.sequence, maps[0], maps[1], light)


def without_inverses(of: Variant) -> Variant:
    keep = [i for i, frame in enumerate(of.sequence.frames) if not frame.inverted]
    frames = tuple(of.sequence.frames[i] for i in keep)
    shown = Sequence(frames, of.sequence.rows, of.sequence.cols, "procam", of.sequence.nominal)
    return Variant(of.frames[keep], shown, of.u, of.v, of.light)


def as_jpeg(of: Variant, quality: int = 90) -> Variant:
    packed = [cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])[1] for frame in of.frames]
    frames = np.stack([cv2.imdecode(one, cv2.IMREAD_GRAYSCALE) for one in packed])
    return Variant(frames, of.sequence, of.u, of.v, of.light)


def cropped(of: Variant) -> Variant:
    frames = np.ascontiguousarray(of.frames[:, *CROP])
    return Variant(frames, of.sequence, of.u[CROP], of.v[CROP], of.light[CROP])


def variant(name: str, whole: Variant) -> Variant:
    made = whole
    if "no inverses" in name:
        made = without_inverses(made)
    if "jpeg" in name:
        made = as_jpeg(made)
    return {"cropped": cropped}.get(name, lambda same: same)(made)


@pytest.fixture(scope="module", params=VARIANTS)
def decoded(request: pytest.FixtureRequest, whole: Variant) -> tuple[str, Variant, Correspondence]:
    made = variant(request.param, whole)
    return request.param, made, decode(made.frames, made.sequence)


def test_the_lit_board_is_good(decoded: tuple[str, Variant, Correspondence]) -> None:
    """One weak finest bit is a cell of doubt, which sigma says, and no reason for a flag."""
    _, made, found = decoded
    assert found.good[made.lit].mean() >= GOOD


def test_nothing_unflagged_is_grossly_wrong(decoded: tuple[str, Variant, Correspondence]) -> None:
    name, made, found = decoded
    use = made.lit & found.good
    assert use.any()
    error = np.hypot(found.u - made.u, found.v - made.v)[use]
    sigma = np.hypot(found.sigma_u, found.sigma_v)[use]  # a weak bit costs resolution, not the pixel
    assert (error <= np.maximum(GROSS_JPEG if "jpeg" in name else GROSS, 5 * sigma)).all()
