"""Do the frames agree with their description? Tests of every capture; one that fails refuses pixels.

Each test has a figure, which is small in a right capture, a limit, and words that hold beyond it. All work on
samples: blocks of the frames with their lag and response corrected, patches of the maps, windows.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.kernels import F32, F64, I64
from optolever.notices import Judged, Notice
from optolever.patterns import Sequence

from ..correspondence import Correspondence, Flag
from ..frames import Light
from ..noise import quantile
from ..pixels import AxisTable
from ..plan import AxisPlan, Code, Plan, plan
from .blocks import Fits, Words, blocks_of, cut, fits_of, places, words_of
from .too_few import few_good
from .windows import EVERY, around, contradictions, residual_windows, spread

__all__ = ["Decoded", "Verdict", "judged"]

Mask = NDArray[np.bool_]
#: Fewest pixels of a figure; amplitude of bright ones over the 0.9 quantile; condition of harmonics from
#: which on the phases fill no turn; upper quartiles beyond which a deviation is of a part of the image.
_FEWEST, _BRIGHT, _TURN, _PART = 100, 0.3, 10.0, 10.0
#: Fewest pixels at an edge; bits that are too fine.
_PAIRS, _FINE = 20, 2
#: Side of a patch, pixels; patches along an axis, and share of rough pixels above which there are more.
_PATCH, _PATCHES, _DOUBTFUL = 32, (3, 7), 0.02
#: Limit of windows of residuals.
_RESIDUAL = 30.0
#: Lag from which on heights of three steps err by 1.4 sigma and more.
_SHORT, _SETTLED = 0.01, "show four steps, or wait longer before each picture"
_ASK = "optolever explain names the likeliest mistake"
_CHECK = "no coordinates there; check the frames and capture.toml"


class Decoded(NamedTuple):
    """A decoded capture. residual (h, w): chi2 of every EVERY-th pixel; noise, tables, matrix: of its
    profile; moved: whether the mirror moved; mask (H, W): pixels that whole blocks may lie in; lag: of a
    ladder of three steps in colour, NaN without."""

    found: Correspondence
    residual: F32
    light: Light
    sequence: Sequence
    noise: tuple[np.float32, np.float32]
    tables: tuple[AxisTable, ...]
    matrix: F64 | None
    moved: bool
    mask: Mask | None
    lag: float


class Verdict(NamedTuple):
    """wrong (H, W): pixels refused; notices; tests: figures of all that could be taken."""

    wrong: Mask
    notices: tuple[Notice, ...]
    tests: tuple[Judged, ...]


class _Seen(NamedTuple):
    """Of blocks of the frames (B, side, side): fringes and words, and the median of the fringes' mean levels
    (None: of less than two); samples (N, B, side, side) that are not saturated; pixels of enough contrast."""

    fits: Fits
    words: dict[str, Words]
    usual: F32 | None
    whole: Mask
    lit: Mask
    plan: Plan
    found: Correspondence


class _Test(NamedTuple):
    """figure: of an axis, NaN where the capture has none; words: of a figure beyond the limit."""

    name: str
    limit: float
    words: str
    figure: Callable[[_Seen, AxisPlan], float]
    cure: str = _ASK


def judged(given: Decoded) -> Verdict:
    """All tests of a capture. The first of the whole capture that fails refuses all pixels."""
    found, light, known = given.found, given.light, plan(given.sequence)
    wrong, shares = contradictions(found.flags, light.numbers, given.noise, known, given.tables, given.moved)
    ratio = _residuals(given, known)
    few, certain = few_good(found, light, given.sequence)
    rows = _whole(given, known, certain)
    if given.lag == given.lag:
        words = f"a lag of about {100 * given.lag:.2g} % of the display, which three steps take for places"
        rows.append(Judged("lag of three steps", given.lag, _SHORT, words, _SETTLED))
    refused = [row for row in rows if row.fails][:1]  # the others follow from it
    cure = _ASK if wrong.all() else _CHECK
    parts = [
        Judged("bits against fringes", share, 0.0, f"bits and fringes of {axis} contradict each other", cure)
        for axis, share in shares.items()
    ]
    share = f"{(ratio > _RESIDUAL).mean():.2g} of the image"
    if (ratio > _RESIDUAL).any():
        wrong |= spread(around(ratio > _RESIDUAL) > 0, EVERY, wrong.shape)
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
            rows.append(
                Judged(test.name, known_ones[axis], test.limit, test.words.format(axis=axis), test.cure)
            )
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
    usual = quantile(amplitude[good], 0.5) if good.any() else 1.0
    square = given.residual * noise / np.square(np.maximum(amplitude, max(0.5 * usual, 1.0)))
    return residual_windows(np.asarray(square, np.float32), good, _RESIDUAL)


def _seen(given: Decoded, at: I64, known: Plan) -> _Seen:
    raw, light = cut(given.light.raw, at), given.light
    whole = raw < light.clip
    levels = light.table[raw] if len(light.table) else raw.astype(np.float32)
    if not whole.all():
        levels[~whole] = light.white
    if given.matrix is not None:
        levels = np.tensordot(given.matrix.astype(np.float32), levels, 1)
    dark = cut(given.found.flags, at) & (Flag.DARK | Flag.LOW_CONTRAST | Flag.INVALID)
    fits = fits_of(levels, known)
    every = np.sort([fit.offset for some in fits.values() for fit in some if fit is not None], axis=0)
    half = len(every) // 2
    usual = 0.5 * (every[half] + every[-half - 1]) if len(every) > 1 else None
    return _Seen(fits, words_of(levels, known, fits), usual, whole, dark == 0, known, given.found)


def _unplaced(seen: _Seen, axis: AxisPlan) -> float:
    """Share of the pixels of enough contrast that plain decoding does not place; of absolute codes."""
    absolute = axis.code is not None or bool(axis.fringes and axis.fringes[0].period >= axis.extent)
    if axis.looked_up or not absolute or seen.lit[:, 1:-1, 1:-1].sum() < _FEWEST:
        return float("nan")
    words = seen.words.get(axis.axis)
    return 1 - float(places(seen.lit.shape, axis, words, seen.fits, seen.lit)[0])


def _mean_levels(seen: _Seen, axis: AxisPlan) -> float:
    """Mean level of a fringe off the median of all fringes', over its amplitude: size of its constant and
    first harmonic over the phase."""
    worst = float("nan")
    for fringe, fit in zip(axis.fringes, seen.fits[axis.axis], strict=False):
        if fit is not None and seen.usual is not None:
            use = fit.amplitude > _BRIGHT * quantile(fit.amplitude, 0.9)
            use &= seen.whole[list(fringe.index)].all(axis=0)
            off = np.asarray((fit.offset - seen.usual) / fit.amplitude, np.float32)
            worst = float(np.fmax(worst, _harmonic(off[use], fit.phase[use])))
    return worst


def _harmonic(off: F32, turn: F32) -> float:
    """Size of constant and first harmonic in deviations (K,) at phases (K,), of the constant where these fill
    no turn."""
    usual = np.abs(off) <= _PART * quantile(np.abs(off), 0.75) if off.size else np.zeros(0, np.bool_)
    if np.count_nonzero(usual) < _FEWEST:
        return float("nan")
    angle = np.float32(2 * np.pi) * turn[usual]
    terms = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)]).astype(np.float64)
    if np.linalg.cond(terms @ terms.T) > _TURN**2:
        terms = terms[:1]
    return float(np.linalg.norm(np.linalg.solve(terms @ terms.T, terms @ off[usual])))


def _cells(seen: _Seen, axis: AxisPlan, code: Code, fine: int) -> I64:
    """Cells, without their last binary digits, of pixels (B, side, side); -1: in doubt."""
    middle, width, decided = seen.words[axis.axis]
    cell = np.rint((middle[0] - code.origin - 0.5 * (width - 1)) / code.cell).astype(np.int64) >> fine
    return np.where(decided & seen.lit & (width <= 1.01 * 2**fine * code.cell), cell, -1)


def _across(image: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Values (K,) of three pixels beside each other along either axis of blocks (B, side, side)."""
    ways = image, image.swapaxes(1, 2)
    return tuple(
        np.concatenate([way[..., k : way.shape[2] - 2 + k].ravel() for way in ways]) for k in range(3)
    )


def _words(seen: _Seen, axis: AxisPlan) -> float:
    """Share of the ends of cells that lie a quarter of a period and more off their places by the fringe."""
    code, fit = axis.code, next((one for one in seen.fits[axis.axis] if one is not None), None)
    if code is None or fit is None:
        return float("nan")
    first, _, second = _across(_cells(seen, axis, code, 0))
    edge = np.flatnonzero((np.minimum(first, second) >= 0) & (np.abs(first - second) == 1))
    turn, end = [one[edge] for one in _across(fit.phase)], np.maximum(first, second)[edge] * code.cell
    resolved = np.maximum(_apart(turn[0], turn[1]), _apart(turn[2], turn[1])) < 0.25
    off = _apart(turn[1], (end + (code.origin - 0.5)) / fit.period)[resolved]
    return float((off > 0.25).mean()) if off.size >= _PAIRS else float("nan")


def _apart(turn: F32, other: NDArray[Any]) -> NDArray[Any]:
    """Distance of two phases, periods."""
    off = turn - other
    return np.asarray(np.abs(off - np.rint(off)))


def _edges(seen: _Seen, axis: AxisPlan) -> float:
    """Share of the pixels at edges of one Gray bit where a finer one is dark that must be bright, next to it,
    or bright that must be dark: of the worst bit, in its best place of several."""
    if axis.code is None or axis.fringes or axis.code.kind != "gray":  # fringes know more
        return float("nan")
    figures, (first, _, second) = [float("nan")], _across(_cells(seen, axis, axis.code, _FINE))
    word, flips = first ^ first >> 1, (first ^ first >> 1) ^ (second ^ second >> 1)
    one = (np.minimum(first, second) >= 0) & (flips & flips - 1 == 0)
    for bit in range(1, len(axis.code.plain) - _FINE - 1):
        for edges, wrong in ((one & (flips == 2 << bit), 0), (one & (flips > 2 << bit), 1)):
            place = first[edges] >> bit + 1 + wrong
            number, off = np.bincount(place), np.bincount(place, word[edges] >> bit & 1 == wrong)
            if np.count_nonzero(number >= _PAIRS) > 1:  # an edge in depth is one place
                figures.append(float((off / np.maximum(number, 1))[number >= _PAIRS].min()))
    return float(np.fmax.reduce(figures))


def _rough(seen: _Seen, axis: AxisPlan) -> float:
    """Share of rough pixels, in few patches, and where this is much in more of them."""
    figure = _rough_share(seen.found, axis.axis, _PATCHES[0])
    return _rough_share(seen.found, axis.axis, _PATCHES[1]) if figure > _DOUBTFUL else figure


def _rough_share(found: Correspondence, axis: str, patches: int) -> float:
    """Share of the good pixels more than five sigma, two pattern px and twice the median step between pixels
    off the median of 5 x 5, in so many patches along the image's axes."""
    starts = [
        np.unique(np.linspace(0, max(size - _PATCH, 0), min(-(-size // _PATCH), patches)).astype(int))
        for size in found.flags.shape
    ]
    place, sigma, flags = (
        np.stack([image[y : y + _PATCH, x : x + _PATCH] for y, x in product(*starts)])
        for image in (*(getattr(found, f"{name}{axis}") for name in ("", "sigma_")), found.flags)
    )
    shape, rows = place.shape, (-1, place.shape[2])  # patches below each other
    good = flags == 0
    use = good & (cv2.blur(good.astype(np.float32).reshape(rows), (5, 5)).reshape(shape) > 0.7)
    use[:, :2], use[:, -2:], use[..., :2], use[..., -2:] = False, False, False, False
    usual = cv2.medianBlur(place.astype(np.float32).reshape(rows), 5).reshape(shape)
    away = np.abs(place - usual)
    off = (away > np.maximum(5 * sigma, 2)) & use
    for k in np.flatnonzero(off.any(axis=(1, 2))):  # few, in right captures
        steps = [np.median(np.abs(np.diff(usual[k], axis=way))) for way in (0, 1)]
        off[k] &= away[k] > 2 * max(steps)
    return float(off[use].mean()) if np.count_nonzero(use) >= _FEWEST else float("nan")


def _orders(seen: _Seen, axis: AxisPlan) -> float:
    """Share of the pixels of enough contrast without an order of their own or their neighbours, of close
    periods in colour."""
    close = axis.code is None and len(axis.fringes) > 1 and axis.fringes[0].period < axis.extent
    if seen.plan.packing is None or not close:
        return float("nan")
    lit = seen.found.flags[seen.found.flags & (Flag.DARK | Flag.LOW_CONTRAST | Flag.INVALID) == 0]
    return float((lit & (Flag.ORDER_DOUBTFUL | Flag.OUTLIER) != 0).mean()) if lit.size else float("nan")


#: The first that fails speaks; the first of all needs enough light.
TESTS = (
    _Test("unplaced", 0.7, "the pictures of {axis} differ from their description or its order", _unplaced),
    _Test(
        "mean levels", 0.08,
        "fringes of {axis} have unequal mean levels: a picture is another, or of other light", _mean_levels,
    ),
    _Test(
        "words", 0.2, "bits and fringes of {axis} change apart: cells, periods or shifts are others", _words,
    ),
    _Test(
        "edges", 0.5, "bits of {axis} change where Gray bits do not: a picture is another", _edges,
    ),
    _Test(
        "rough", 0.06,
        "neighbouring pixels see places of {axis} far apart: a picture is another", _rough,
    ),
    _Test(
        "orders", 0.5, "fringe orders of {axis} are ambiguous, most likely by the order of colours", _orders,
        "state the display's stripes (show --colour), and give pictures in red, green, blue",
    ),
)  # fmt: skip
