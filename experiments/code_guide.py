"""Comparison of codes: number of frames, errors and detection of faults, by the decoder on simulated patches.

White Gaussian noise only, pixels without a footprint: the limits of the codes. The effects of a display's
cells, blur, a dented mirror or a camera's footprint are computed by `optolever design`.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.patterns import BINARY_CODES, Sequence, sequence_from_text
from optolever.records import Progress, silent

from .arrays import Floats, Mask
from .ideal import Fault, camera_frames
from .metrics import rms

#: Default codes: bits, fringes, both, sweeps.
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
#: Camera of the trials, pixels: a patch each at the start, the middle and the end of the surface.
_PATCHES, _PATCH = 3, (32, 128)
_SILENT = 1e-4
#: Maximum share of good pixels in a failed capture, and minimum for a working code, among illuminated pixels.
_REFUSED, _DECODED = 0.1, 0.9
#: Codes for weak modulation, by number of frames.
_PATIENT = ("phase", "phase:steps=8", "phase:steps=16")
#: Modulation over noise of the trials for comparison with a failed capture, and factors on the exposure.
_RATIOS = np.geomspace(1, 8, 4)
_EXPOSURES = (1.5, 2, 3, 4, 6)
_AS_ROUGH = 0.5  # of the amplitude's second differences by noise
_MARGIN = 0.9  # safety factor on the modulation, for cures
_AMPLITUDE = 60.0  # of the trials, levels: only its ratio to the noise matters
#: Steps of the trials' camera per level: its rounding error is negligible.
_STEPS = 16


@dataclass(frozen=True, slots=True)
class CodeRow:
    """sigma: px, of the worse axis; gross: share of wrong orders or bits, either axis; reach: unambiguous
    range in px, of the axis with the shorter one; stripe: narrowest, px; lost, swapped: shares of trials with
    a lost or swapped frame without unflagged errors.
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
    sequences = [(name, sequence_from_text(name, *size)) for name in names]
    for done, (name, shown) in enumerate(sequences):
        progress(name, done, len(sequences))
        lost, swapped = _detected(shown, amplitude, noise)
        reach, sigma, gross, stripe = predict_code(shown, amplitude, noise)
        yield CodeRow(name, len(shown), reach, sigma, gross, stripe, lost, swapped)


def predict_code(shown: Sequence, amplitude: float, noise: float) -> tuple[float, float, float, float]:
    """(range, sigma, gross rate, narrowest stripe), px but for the rate. InputError if nothing is encoded.

    sigma: rms error of the worse axis over the pixels with neither flag nor gross error; gross rate: the
    measured one, or the decoder's stated one if it is larger.
    """
    axes = [axis for axis in "uv" if any(axis in (frame.axis or "") for frame in shown.frames)]
    if not axes:
        raise InputError(f"sequence {shown.name}: no frame encodes u or v")
    u, v = _places(shown)
    found = decode(seen(shown, u, v, amplitude, noise, np.random.default_rng(0)), shown, on_cells=False)
    wrong = _wrong(found, shown, u, v)
    stands = found.good & ~wrong
    errors = [(found.u - u if axis == "u" else found.v - v)[stands] for axis in axes]
    sigma = max(rms(error) for error in errors)
    stated = 0.0 if found.order_error is None else float(np.mean(found.order_error))
    reach = min(_reach(shown, axis) for axis in axes)
    return reach, sigma, max(float(wrong.mean()), stated), min(_narrowest(shown, axis) for axis in axes)


def code_that_decodes(found: Correspondence, shown: Sequence) -> Notice | None:
    """The notice of a capture whose modulation is too weak for its sequence `shown`: the exposure or the code
    that would decode. None where enough pixels are good, or where noise is not the cause.

    Modulation over noise is that of a simulated capture of the same sequence with the same median sigma of
    the illuminated pixels, provided that the amplitudes of adjacent pixels differ as much. Codes are then
    tried by simulation and decoding.
    """
    if found.amplitude is None or not (found.amplitude > 0).any():
        return None
    lit = found.amplitude > 0.5 * np.nanpercentile(found.amplitude, 95)
    if found.good[lit].mean() > _REFUSED:
        return None
    ratio = _modulation(found, lit, shown)
    if ratio is None:
        return None
    alike = _trial(shown, ratio)
    if alike.good.mean() > _REFUSED or _roughness(found, lit) < _AS_ROUGH * _roughness(alike):
        return None
    surely = _MARGIN * ratio
    longer = next((by for by in _EXPOSURES if _good_share(shown, by * surely) > _DECODED), None)
    cure = f"expose {'more than ' if longer is None else ''}{longer or _EXPOSURES[-1]:g} times as long"
    for text in _PATIENT:
        code = sequence_from_text(text, shown.rows, shown.cols)
        if _good_share(code, surely) > _DECODED:
            cure += f", or show --sequence {text} ({len(code)} frames)"
            break
    share = float(found.good[lit].mean())
    name = (
        f"The pattern is too weak for {shown.name}: its modulation is {ratio:.2g} times the noise of a "
        "frame; share of good pixels"
    )
    return Notice(name, share, _DECODED, cure)


def _modulation(found: Correspondence, lit: Mask, shown: Sequence) -> float | None:
    """Amplitude over a frame's noise of illuminated pixels (H, W), by their sigma; None where unknown."""
    stated = _median_sigma(found, lit)
    trials = [(ratio, _median_sigma(_trial(shown, ratio))) for ratio in _RATIOS]
    known = [(sigma, ratio) for ratio, sigma in trials if np.isfinite(sigma)]
    if not np.isfinite(stated) or len(known) < 2:
        return None
    sigma, ratios = np.array(sorted(known)).T
    return float(np.exp(np.interp(np.log(stated), np.log(sigma), np.log(ratios))))


def _median_sigma(found: Correspondence, lit: Mask | None = None) -> float:
    """Median over pixels of the smaller sigma of both axes, px."""
    sigma = np.minimum(found.sigma_u, found.sigma_v)
    return float(np.median(sigma if lit is None else sigma[lit]))


def _roughness(found: Correspondence, lit: Mask | None = None) -> float:
    """Median second difference of the amplitude along rows over the median amplitude, a measure of noise."""
    assert found.amplitude is not None
    bend = np.abs(np.diff(found.amplitude, 2, axis=1))
    known = np.ones(found.flags.shape, np.bool_) if lit is None else lit
    inside = known[:, :-2] & known[:, 1:-1] & known[:, 2:]
    return float(np.median(bend[inside]) / np.median(found.amplitude[known])) if inside.any() else 0.0


def _good_share(shown: Sequence, ratio: float) -> float:
    return float(_trial(shown, ratio).good.mean())


def _trial(shown: Sequence, ratio: float) -> Correspondence:
    """Simulated patches with this amplitude over noise, decoded."""
    u, v = _places(shown)
    frames = seen(shown, u, v, _AMPLITUDE, _AMPLITUDE / ratio, np.random.default_rng(0))
    return decode(frames, shown, on_cells=False)


def _reach(shown: Sequence, axis: str) -> float:
    """Unambiguous range along an axis, px, of a code, its coarsest fringe, or all fringes together."""
    extent = shown.cols if axis == "u" else shown.rows
    mine = [frame for frame in shown.frames if frame.axis == axis]
    bits = [frame for frame in mine if frame.kind in BINARY_CODES]
    periods = [frame.period_px for frame in mine if frame.period_px is not None]
    if bits:
        return min(extent, bits[0].cell_px * 2.0 ** (1 + max(frame.bit or 0 for frame in bits)))
    if not periods or max(periods) >= extent:
        return extent
    return min(extent, math.lcm(*(Fraction(period).limit_denominator(64).numerator for period in periods)))


def _narrowest(shown: Sequence, axis: str) -> float:
    """Narrowest stripe along an axis, brighter or darker than mid grey, except at the surface's ends."""
    runs = [math.inf]
    for frame in shown.frames:
        if axis in (frame.axis or ""):
            level = frame.tables(shown.rows, shown.cols)["uv".index(axis)] - 127.5
            before = np.flatnonzero(np.diff(level > 0))
            runs += np.diff(before + level[before] / (level[before] - level[before + 1])).tolist()
    return round(float(min(runs)), 1)


def _places(shown: Sequence) -> tuple[Floats, Floats]:
    """Coordinates (u, v) of the trials' pixels: patches one below the other, about one cell per pixel."""
    rows, cols = (min(n, size - 4) for n, size in zip(_PATCH, (shown.rows, shown.cols), strict=True))
    row, col = np.mgrid[:rows, :cols].astype(np.float64)
    u = 0.93 * (col - cols / 2) + 2 * np.sin(row / 19)
    v = 0.95 * (row - rows / 2) + 2 * np.cos(col / 23)
    share = np.linspace(-0.5, 0.5, _PATCHES)
    room = shown.cols - cols - 4, shown.rows - rows - 4
    middle = shown.cols / 2, shown.rows / 2
    return (
        np.concatenate([u + middle[0] + part * max(room[0], 0) for part in share]),
        np.concatenate([v + middle[1] + part * max(room[1], 0) for part in share]),
    )


def seen(
    shown: Sequence, u: Floats, v: Floats, amplitude: float, noise: float, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """Frames (N, H, W) of pixels at (u, v), from 1 to 3 amplitudes, in levels / _STEPS."""
    return camera_frames(shown, (u, v), (2 * amplitude, amplitude), noise, rng, _STEPS).astype(np.uint16)


def _wrong(found: Correspondence, shown: Sequence, u: Floats, v: Floats) -> NDArray[np.bool_]:
    """Pixels with an error above 5 sigma; for codes of bits only, above 1.5 cells."""
    discrete = not any(frame.kind in ("phase", "stripe", "levels") for frame in shown.frames)
    off = np.zeros(u.shape, np.bool_)
    for coord, sigma, true in ((found.u, found.sigma_u, u), (found.v, found.sigma_v, v)):
        off |= np.abs(coord - true) > (1.5 if discrete else 5 * sigma)
    return off


def _detected(shown: Sequence, amplitude: float, noise: float) -> tuple[float, float]:
    """Shares of lost and of swapped frames without unflagged errors, among frames that visibly change."""
    u, v = _places(shown)
    whole = seen(shown, u, v, amplitude, noise, np.random.default_rng(0))

    def told(frames: NDArray[np.uint16]) -> bool:
        found = decode(frames, shown, on_cells=False)
        return bool((_wrong(found, shown, u, v) & found.good).sum() <= _SILENT * found.good.sum())

    # a camera of the full surface records a change in every frame; these patches only in some
    change = np.flatnonzero(np.ptp(whole[:-1], axis=(1, 2)) > 0.5 * amplitude * _STEPS)
    tried = np.unique(change[np.linspace(0, len(change) - 1, 6).astype(int)])
    lost = [told(Fault("lost", k, k).spoil(whole)) for k in tried]
    swapped = [told(Fault("swapped", k, k + 1).spoil(whole)) for k in tried]
    return float(np.mean(lost)), float(np.mean(swapped))
