"""Do the frames agree with their description? Tests of every capture; one that fails refuses pixels.

Each test has a figure, which is small in a right capture, a limit, and words that hold beyond it. All work on
samples: blocks of the frames with their lag and response corrected, patches of the maps, windows.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, F64, I64
from optolever.notices import Judged, Notice
from optolever.patterns import Sequence

from ..correspondence import Correspondence, Flag
from ..frames import Light
from ..pixels import AxisTable
from ..plan import AxisPlan, Plan, plan
from .blocks import Fits, blocks_of, cut, fits_of, places, word_places
from .too_few import few_good
from .windows import EVERY, contradictions, residual_windows, spread, typical

__all__ = ["Decoded", "Verdict", "judged"]

Mask = NDArray[np.bool_]
#: Fewest pixels of a figure; amplitude of bright ones over the 0.9 quantile; condition of harmonics from
#: which on the phases fill no turn; medians beyond which a deviation is of a part, not of a picture.
_FEWEST, _BRIGHT, _TURN, _PART = 100, 0.3, 10.0, 6.0
#: Distance of two words, pixels; fewest pairs of them.
_APART, _PAIRS = 5, 30
#: Side of a patch, pixels; patches along an axis.
_PATCH, _PATCHES = 32, 4
#: Limit of windows of residuals.
_RESIDUAL = 30.0
_ASK = "optolever explain names the likeliest mistake"
_CHECK = "no coordinates there; check the frames and capture.toml"


class Decoded(NamedTuple):
    """A decoded capture. residual (h, w): chi2 of every EVERY-th pixel; noise, tables, matrix: of its
    profile; moved: whether the mirror moved; mask (H, W): pixels that whole blocks may lie in."""

    found: Correspondence
    residual: F32
    light: Light
    sequence: Sequence
    noise: tuple[np.float32, np.float32]
    tables: tuple[AxisTable, ...]
    matrix: F64 | None
    moved: bool
    mask: Mask | None


class Verdict(NamedTuple):
    """wrong (H, W): pixels refused; notices; tests: figures of all that could be taken."""

    wrong: Mask
    notices: tuple[Notice, ...]
    tests: tuple[Judged, ...]


class _Seen(NamedTuple):
    """Blocks of the frames as linear levels (N, B, side, side), and their fringes; pixels (B, side, side)
    without saturated samples; of enough contrast; first pixels (B, 2)."""

    levels: F32
    fits: Fits
    whole: Mask
    lit: Mask
    at: I64
    plan: Plan
    found: Correspondence


class _Test(NamedTuple):
    """figure: of an axis, NaN where the capture has none; words: of a figure beyond the limit."""

    name: str
    limit: float
    words: str
    figure: Callable[[_Seen, AxisPlan], float]


def judged(given: Decoded) -> Verdict:
    """All tests of a capture. The first of the whole capture that fails refuses all pixels."""
    found, light, known = given.found, given.light, plan(given.sequence)
    numbers = light.raw, light.table if len(light.table) else None, np.float32(min(light.clip, 1e9))
    wrong, shares = contradictions(found.flags, numbers, given.noise, known, given.tables, given.moved)
    ratio = _residuals(given, known)
    few, certain = few_good(found, light, given.sequence)
    rows = _whole(given, known, certain)
    refused = [row for row in rows if row.fails][:1]  # the others follow from it
    cure = _ASK if wrong.all() else _CHECK
    parts = [
        Judged("bits against fringes", share, 0.0, f"bits and fringes of {axis} contradict each other", cure)
        for axis, share in shares.items()
    ]
    share = f"{(ratio > _RESIDUAL).mean():.2g} of the image"
    if (ratio > _RESIDUAL).any():
        wrong |= spread(ratio > _RESIDUAL, EVERY, wrong.shape)
    words = f"the steps of a fringe contradict each other in {share}"
    parts.append(Judged("residuals in windows", float(ratio.max(initial=0.0)), _RESIDUAL, words, _CHECK))
    notices = [row.notice for row in refused or [row for row in parts if row.fails]]
    if few is not None and (certain or not notices):
        notices.insert(0, few)
    return Verdict(wrong | bool(refused), tuple(notices), (*rows, *parts))


def _whole(given: Decoded, known: Plan, weak: bool) -> list[Judged]:
    """Tests of the whole capture, of the worst axis; weak: whether light explains pixels without a place."""
    at = blocks_of(given.light.raw, given.mask)
    if at is None:
        return []
    seen, rows = [_seen(given, at, known)], list[Judged]()
    if len(given.light.table):  # a response that is not this display's bends right levels
        bare = replace(given.light, table=np.zeros(0, np.float32))
        seen.append(_seen(given._replace(light=bare), at, known))
    for test in TESTS[weak:]:
        figures = {axis.axis: min(test.figure(one, axis) for one in seen) for axis in known.axes}
        known_ones = {axis: float(one) for axis, one in figures.items() if one == one}
        if known_ones:
            axis = max(known_ones, key=lambda name: known_ones[name])
            rows.append(Judged(test.name, known_ones[axis], test.limit, test.words.format(axis=axis), _ASK))
    return rows


def _residuals(given: Decoded, known: Plan) -> F32:
    """Windows of residuals, by every EVERY-th pixel (h, w); 0 where none are known."""
    found, some = given.found, (slice(None, None, EVERY),) * 2
    assert found.amplitude is not None
    assert found.offset is not None
    if any(axis.looked_up for axis in known.axes):
        return np.zeros_like(given.residual)
    amplitude, good = found.amplitude[some], found.flags[some] == 0
    noise = given.noise[0] + given.noise[1] * np.maximum(found.offset[some], 0)
    usual = typical(amplitude[good]) if good.any() else 1.0
    square = given.residual * noise / np.square(np.maximum(amplitude, max(0.5 * usual, 1.0)))
    return residual_windows(np.asarray(square, np.float32), good)


def _seen(given: Decoded, at: I64, known: Plan) -> _Seen:
    levels = given.light.linear(cut(given.light.raw, at))
    whole = np.isfinite(levels)
    levels = np.where(whole, levels, np.float32(given.light.white))
    if given.matrix is not None:
        levels = np.tensordot(given.matrix.astype(np.float32), levels, 1)
    dark = cut(given.found.flags, at) & (Flag.DARK | Flag.LOW_CONTRAST | Flag.INVALID)
    return _Seen(levels, fits_of(levels, known), whole, dark == 0, at, known, given.found)


def _unplaced(seen: _Seen, axis: AxisPlan) -> float:
    """Share of the pixels of enough contrast that plain decoding does not place; of absolute codes."""
    absolute = axis.code is not None or bool(axis.fringes and axis.fringes[0].period >= axis.extent)
    if axis.looked_up or not absolute or seen.lit[:, 1:-1, 1:-1].sum() < _FEWEST:
        return float("nan")
    return 1 - float(places(seen.levels, axis, seen.plan, seen.fits, lit=seen.lit)[0])


def _mean_levels(seen: _Seen, axis: AxisPlan) -> float:
    """Mean level of a fringe off the median of all fringes', over its amplitude: size of its constant and
    first harmonic over the phase."""
    every, worst = [fit for fits in seen.fits.values() for fit in fits if fit is not None], float("nan")
    usual = np.median([fit.offset for fit in every], axis=0) if every else 0.0
    for fringe, fit in zip(axis.fringes, seen.fits[axis.axis], strict=False):
        if fit is not None and len(every) > 1:
            use = fit.amplitude > _BRIGHT * np.quantile(fit.amplitude, 0.9)
            use &= seen.whole[list(fringe.index)].all(axis=0)
            off = np.asarray((fit.offset - usual) / fit.amplitude, np.float32)
            worst = float(np.fmax(worst, _harmonic(off[use], fit.phase[use])))
    return worst


def _harmonic(off: F32, turn: F32) -> float:
    """Size of constant and first harmonic in deviations (K,) at phases (K,), of the constant where these fill
    no turn."""
    usual = np.abs(off) <= _PART * np.median(np.abs(off)) if off.size else np.zeros(0, np.bool_)
    if np.count_nonzero(usual) < _FEWEST:
        return float("nan")
    angle = 2 * np.pi * turn[usual].astype(np.float64)
    columns = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    if np.linalg.cond(columns) > _TURN:
        columns = columns[:, :1]
    return float(np.linalg.norm(np.linalg.lstsq(columns, off[usual].astype(np.float64), rcond=None)[0]))


def _words(seen: _Seen, axis: AxisPlan) -> float:
    """Share of good pixels 5 px apart whose words differ by one, and whose places step by half a period more
    or less than others."""
    if axis.code is None or not axis.fringes or axis.looked_up:
        return float("nan")
    code, fits = axis.code, [fit for fit in seen.fits[axis.axis] if fit is not None]
    middle, width, decided = word_places(seen.levels, code, seen.plan, fits)
    cell = (middle[0] - code.origin - (code.cell - 1) / 2) / code.cell
    word = np.where(decided & (width <= 1.01 * code.cell), np.rint(cell), -1)
    place, good = cut(getattr(seen.found, axis.axis), seen.at), cut(seen.found.flags, seen.at) == 0
    off, count = 0, 0
    for way in (1, 2):

        def pair(one: NDArray[np.generic], apart: int, way: int = way) -> tuple[NDArray[np.generic], ...]:
            line = np.moveaxis(one, way, -1)
            return line[..., :-apart], line[..., apart:]

        slope = np.where(np.logical_and(*pair(good, 1)), np.subtract(*pair(place, 1)[::-1]), 0.0)
        usual = _APART * np.median(slope, axis=(1, 2), keepdims=True)  # of a block: a map may fold
        known = np.logical_and(*pair(good & (word >= 0), _APART))
        known &= np.abs(np.subtract(*pair(word, _APART))) == 1
        away = np.abs(np.subtract(*pair(place, _APART)[::-1]) - usual)[known]
        off += int(np.count_nonzero(away > 0.5 * axis.fringes[-1].period))
        count += away.size
    return off / count if count >= _PAIRS else float("nan")


def _rough(seen: _Seen, axis: AxisPlan) -> float:
    """Share of the good pixels more than five sigma, two pattern px and twice the median step between pixels
    off the median of 5 x 5, in patches."""
    starts = [
        np.unique(np.linspace(0, max(size - _PATCH, 0), min(-(-size // _PATCH), _PATCHES)).astype(int))
        for size in seen.found.flags.shape
    ]
    place, sigma, flags = (
        np.stack([image[y : y + _PATCH, x : x + _PATCH] for y, x in product(*starts)])
        for image in (
            *(getattr(seen.found, f"{name}{axis.axis}") for name in ("", "sigma_")),
            seen.found.flags,
        )
    )
    shape, rows = place.shape, (-1, place.shape[2])  # patches below each other
    good = flags == 0
    use = good & (cv2.blur(good.astype(np.float32).reshape(rows), (5, 5)).reshape(shape) > 0.7)
    use[:, :2], use[:, -2:], use[..., :2], use[..., -2:] = False, False, False, False
    usual = cv2.medianBlur(place.astype(np.float32).reshape(rows), 5).reshape(shape)
    steps = [np.median(np.abs(np.diff(usual, axis=way)), axis=(1, 2), keepdims=True) for way in (1, 2)]
    off = np.abs(place - usual) > np.maximum(5 * sigma, np.maximum(2, 2 * np.maximum(*steps)))
    return float(off[use].mean()) if np.count_nonzero(use) >= _FEWEST else float("nan")


#: The first that fails speaks; the first of all needs enough light.
TESTS = (
    _Test("unplaced", 0.7, "the pictures of {axis} differ from their description or its order", _unplaced),
    _Test(
        "mean levels", 0.08,
        "fringes of {axis} have unequal mean levels: a picture is another, or of other light", _mean_levels,
    ),
    _Test(
        "words", 0.2,
        "bits and fringes of {axis} change apart: cells, periods or shifts are others", _words,
    ),
    _Test(
        "rough", 0.06,
        "neighbouring pixels see places of {axis} far apart: a picture is another", _rough,
    ),
)  # fmt: skip
