"""Which code when: what every code costs, tells and detects, predicted in closed form and tried on faults.

Noise alone, white Gaussian, of pixels that see one place each: the codes' own limits. What a display's cells,
blur, a dented mirror or a camera's footprint add is for `optolever design` and `optolever bench`.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from optolever.decode import decode
from optolever.errors import InputError
from optolever.patterns import BINARY_CODES, Frame, Sequence, sequence_from_text

from .demo import Progress, silent
from .ideal import camera_frames, ideal_level

__all__ = ["CODES", "CodeRow", "code_rows", "predict_code", "seen"]

F64 = NDArray[np.float64]
#: What is compared if nothing else is asked for: bits, fringes, both, sweeps.
CODES = (
    "gray",
    "gray:inverses=false",
    "long-run-gray",
    "xor-gray",
    "phase:steps=4",
    "phase:steps=8",
    "phase:steps=4,periods=20/22/25",
    "micro-phase",
    "gray+phase",
    "gray+phase:steps=8,period=16",
    "stripe:step=8",
)
#: Camera of the trials, pixels; one cell each, about the middle of the surface.
_TRIAL = (96, 128)
_SILENT = 1e-4
#: Steps of the trials' camera per level: its rounding is no part of the noise.
_STEPS = 16


@dataclass(frozen=True, slots=True)
class CodeRow:
    """sigma: px, of the worse axis; gross: probability of a wrong order or bit, either axis; reach: px
    without ambiguity (of the shorter one); stripe: px, the narrowest; lost, swapped: shares of trials in
    which such a fault left no unflagged error behind.
    """

    name: str
    frames: int
    reach: float
    sigma: float
    gross: float
    stripe: float
    lost: float
    swapped: float


def code_rows(
    names: Iterable[str],
    size: tuple[int, int],
    amplitude: float,
    noise: float,
    progress: Progress = silent,
) -> Iterator[CodeRow]:
    """A row per code for a surface of size (rows, cols); amplitude (mid grey to white), noise in levels."""
    for name, value in (("amplitude", amplitude), ("noise", noise)):
        if not 0 < value <= 1000:
            raise InputError(f"codes: {name} is {value:g}, must be above 0 and at most 1000 levels")
    listed = list(names)
    for done, name in enumerate(listed):
        progress(name, done, len(listed))
        shown = sequence_from_text(name, *size)
        lost, swapped = _detected(shown, amplitude, noise)
        reach, sigma, gross, stripe = predict_code(shown, amplitude, noise)
        yield CodeRow(name, len(shown), reach, sigma, gross, stripe, lost, swapped)


def predict_code(shown: Sequence, amplitude: float, noise: float) -> tuple[float, float, float, float]:
    """(range, sigma, gross rate, narrowest stripe), px but for the rate. InputError if nothing is encoded."""
    shown, gain = _sweeps(shown)
    parts = [
        _axis(shown, axis, gain * amplitude / noise)
        for axis in "uv"
        if any(f.axis == axis for f in shown.frames)
    ]
    if not parts:
        raise InputError(f"sequence {shown.name}: no frame encodes u or v")
    reach, sigma, gross, stripe = zip(*parts, strict=True)
    return min(reach), max(sigma), 1 - math.prod(1 - rate for rate in gross), min(stripe)


def _sweeps(shown: Sequence) -> tuple[Sequence, float]:
    """A raster of spots as the two sweeps of a stripe that tell as much, and the gain of their amplitude.

    Rows of the raster see the same sweep along u, f times as bright: sum f^2 = 3/4 width / step of a raised
    cosine (a decoder that adds them up unweighed is a tenth behind, with 1.5 steps of width a quarter).
    Any other sequence as it is.
    """
    spots = [frame for frame in shown.frames if frame.kind == "stripe" and frame.axis == "uv"]
    if not spots:
        return shown, 1.0
    width = spots[0].width_px or 1.0
    at = {axis: sorted({getattr(frame, f"at_{axis}") for frame in spots}) for axis in "uv"}
    frames = [
        Frame("stripe", axis, width_px=width, **{f"at_{axis}": place})
        for axis, places in at.items()
        for place in places
    ]
    steps = [float(np.median(np.diff(places))) for places in at.values() if len(places) > 1]
    return replace(shown, frames=tuple(frames)), math.sqrt(0.75 * width / max(steps, default=width))


def _axis(shown: Sequence, axis: str, ratio: float) -> tuple[float, float, float, float]:
    mine = [frame for frame in shown.frames if frame.axis == axis]
    extent = shown.cols if axis == "u" else shown.rows
    fringes = [frame for frame in mine if frame.kind == "phase"]
    code = [frame for frame in mine if frame.kind in BINARY_CODES]
    groups = [(p, len(list(part))) for p, part in groupby(sorted(f.period_px or 1.0 for f in fringes)[::-1])]
    if code or (groups and min(count for _, count in groups) >= 3):
        gross, reach, stripe = _bits(shown, code, axis, ratio, bool(groups))
        sigma = code[0].cell_px / math.sqrt(12) if code else math.inf
        if groups:
            sigma, wrong, far = _fringes(groups, extent, ratio, bool(code))
            gross, reach = gross + wrong, max(reach, far)
            stripe = min(stripe, groups[-1][0] / 2)
        return min(reach, extent), sigma, min(gross, 1.0), stripe
    return (extent, *_free(shown, mine, axis, ratio))


def _bits(
    shown: Sequence, code: list[Frame], axis: str, ratio: float, guides: bool
) -> tuple[float, float, float]:
    """Rate of wrong bits that matter, range, narrowest stripe."""
    if not code:
        return 0.0, 0.0, math.inf
    bits = 1 + max(frame.bit or 0 for frame in code)
    both = {bit for bit in range(bits) if sum(frame.bit == bit for frame in code) > 1}
    rate = 0.0
    # the last bit leads to the next cell, which a fringe mends; and that of a code alone is no gross error
    for bit in range(0 if code[0].kind == "xor-gray" else 1, bits):
        rate += 0.5 * math.erfc(ratio / math.sqrt(2 * (0.5 if bit in both else 1.5)))
    return rate, code[0].cell_px * (1 << bits), _narrowest(shown, code, axis)


def _narrowest(shown: Sequence, code: list[Frame], axis: str) -> float:
    """Narrowest stripe of the bits, the outermost ones apart."""
    runs = [math.inf]
    for frame in code:
        table = frame.tables(shown.rows, shown.cols)["uv".index(axis)].astype(np.int64)
        runs += np.diff(np.flatnonzero(np.diff(table))).tolist()
    return float(min(runs))


def _fringes(
    groups: list[tuple[float, int]], extent: int, ratio: float, coded: bool
) -> tuple[float, float, float]:
    """(sigma, rate of wrong orders, range) of periods from coarse to fine, each with its number of steps."""
    single = [(p, (p / (2 * math.pi)) ** 2 * 2 / (n * ratio**2)) for p, n in groups]
    spans = coded or groups[0][0] >= extent
    wrong = 0.0 if spans else _searched(single, extent)
    variance = single[0][1]
    for period, own in single[1:]:
        if spans:  # a coarser period gives the order only
            wrong += math.erfc(period / 2 / math.sqrt(2 * (variance + own)))
        variance = own if spans else 1 / (1 / variance + 1 / own)
    together = math.lcm(*(Fraction(p).limit_denominator(64).numerator for p, _ in groups))
    return math.sqrt(variance), wrong, groups[0][0] if spans else float(together)


def _searched(single: list[tuple[float, float]], extent: int) -> float:
    """Union bound over the orders of the coarsest period: chi squared of the best place near each of them."""
    coarse = single[0][0]
    rate = 0.0
    for order in range(1, math.ceil(extent / coarse) + 1):
        off = np.array([coarse * order - p * round(coarse * order / p) for p, _ in single])
        weight = np.array([1 / own for _, own in single])
        far = float(np.sum(weight * (off - np.sum(weight * off) / np.sum(weight)) ** 2))
        # a place in the middle has half of the orders on either side
        share = max(1 - order * coarse / extent, 0.0)
        rate += 2 * share * 0.5 * math.erfc(math.sqrt(far) / (2 * math.sqrt(2)))
    return rate


def _free(shown: Sequence, mine: list[Frame], axis: str, ratio: float) -> tuple[float, float, float]:
    """(sigma, rate of wrong places, narrowest stripe) of any grey values: Fisher's bound, union bound."""
    extent = shown.cols if axis == "u" else shown.rows
    frames = [i for i, frame in enumerate(shown.frames) if frame in mine or frame.kind in ("white", "black")]
    place = np.arange(4 * extent) / 4
    level = np.stack([ideal_level(shown, i, place, place) for i in frames]) * 2 * ratio
    slope = np.gradient(level, 0.25, axis=1)
    bound = []
    for k in range(len(place) // 8, len(place) - len(place) // 8, 5):
        basis = np.stack([np.ones(len(frames)), level[:, k]], axis=1)
        left = slope[:, k] - basis @ np.linalg.lstsq(basis, slope[:, k], rcond=None)[0]
        bound.append(float(left @ left))
    level = level - level.mean(axis=0)
    some = np.linspace(0, len(place) - 1, 96).astype(int)
    apart = np.sqrt(((level[:, some, None] - level[:, None, ::4]) ** 2).sum(axis=0))
    gone = np.abs(place[some, None] - place[None, ::4]) > max(4.0, min(_widths(mine)))
    rate = np.where(gone, [[0.5 * math.erfc(d / (2 * math.sqrt(2))) for d in row] for row in apart], 0.0)
    # neighbouring places err together: one of them per width is independent
    gross = float(rate.sum(axis=1).mean()) / max(1.0, min(_widths(mine)))
    return 1 / math.sqrt(float(np.mean(bound))), min(gross, 1.0), min(_widths(mine))


def _widths(mine: list[Frame]) -> list[float]:
    return [frame.width_px or (frame.period_px or 2.0) / 2 for frame in mine]


def seen(
    shown: Sequence, u: F64, v: F64, amplitude: float, noise: float, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """Frames (N, H, W) of pixels that look at (u, v) each, from 1 to 3 amplitudes, in levels / _STEPS."""
    return camera_frames(shown, (u, v), (2 * amplitude, amplitude), noise, rng, _STEPS).astype(np.uint16)


def _detected(shown: Sequence, amplitude: float, noise: float) -> tuple[float, float]:
    """Shares of lost and of swapped frames, of those that are seen to change, without unflagged errors."""
    rng = np.random.default_rng(0)
    rows, cols = (min(n, extent - 4) for n, extent in zip(_TRIAL, (shown.rows, shown.cols), strict=True))
    row, col = np.mgrid[:rows, :cols].astype(np.float64)
    u = 0.93 * (col - cols / 2) + 2 * np.sin(row / 19) + shown.cols / 2
    v = 0.95 * (row - rows / 2) + 2 * np.cos(col / 23) + shown.rows / 2
    whole = seen(shown, u, v, amplitude, noise, rng)
    discrete = not any(frame.kind in ("phase", "stripe", "levels") for frame in shown.frames)

    def told(frames: NDArray[np.uint16]) -> bool:
        found = decode(frames, shown, on_cells=False)
        off = np.zeros(u.shape, np.bool_)
        for coord, sigma, true in ((found.u, found.sigma_u, u), (found.v, found.sigma_v, v)):
            off |= np.abs(coord - true) > (1.5 if discrete else 5 * sigma)
        return bool((off & found.good).sum() <= _SILENT * found.good.sum())

    # a camera that sees all of the surface sees every frame change; this one some
    change = np.flatnonzero(np.ptp(whole[:-1], axis=(1, 2)) > 0.5 * amplitude * _STEPS)
    tried = np.unique(change[np.linspace(0, len(change) - 1, 6).astype(int)])
    lost = [told(np.concatenate([whole[:k], whole[k + 1 :], whole[-1:]])) for k in tried]
    swapped = [told(whole[[*range(k), k + 1, k, *range(k + 2, len(whole))]]) for k in tried]
    return float(np.mean(lost)), float(np.mean(swapped))
