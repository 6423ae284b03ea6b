"""Latency, settling and shutter of a display and a camera, measured by full-screen flips.

The camera is the photodiode: brightness of bands of rows against the times of pseudo-random swaps. Band r
(0 top, 1 bottom) of an image with stamp s is the mean over [s + r shutter, + exposure] of cells that follow
every swap `latency` later, with separate time constants for rise and fall. Four numbers, a gain and an
offset per band; least squares.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.projector import Accepted, Camera, Display, Time

from .arrivals import Arrivals
from .clocks import ClockMap
from .sync_result import Timing

__all__ = ["FlipRecord", "fit_timing", "sync_notices", "synchronise"]


_BANDS = 16
_FLIPS = 60
_REFRESH_S = 1 / 60  # assumed where unknown: unit of the time between flips
_WHITE_IMAGES = 32
_STILL_S, _PATIENCE_S = 0.5, 5.0  # after a swap until the light is still; until an image must have come
_LIT = 0.3  # of the largest swing: pixels that see the display
_SWING = 8.0  # levels, at least
_LATENCIES = np.arange(-0.02, 0.3, 0.004)
_CELLS_S = 0.005  # time constant of cells that a fit starts from
_LATENESS_STEP_S = 0.001
_LATENESS = np.arange(-0.01, 0.0605, _LATENESS_STEP_S)
_CERTAIN = 16.0  # squared residuals, in their variance, that a late swap explains
_LATE_S = 0.004  # a swap whose light is later than the others' by more does not count in the fit
_MISFIT = 0.03
_UNSEEN_S = 0.005  # sigma of a time constant
_ROUNDS = 3
_LOWEST, _HIGHEST = np.array([-0.1, 1e-4, 1e-4, -0.1]), np.array([0.5, 0.2, 0.2, 0.1])  # numbers of a fit, s
_LEAST_SCATTER = 1e-6  # of the swing


@dataclass(frozen=True, slots=True, eq=False)
class FlipRecord:
    """stamps_s (N,) and their sigma; brightness (N, B) of bands with middles `bands` (0 to 1); swaps_s (F,)
    and the level (0 or 1) after each; delays_s (N,) from stamp to arrival; flicker: of white images.
    """

    stamps_s: Floats
    sigma_s: float
    brightness: Floats
    bands: Floats
    swaps_s: Floats
    levels: Floats
    delays_s: Floats
    flicker: float


def synchronise(
    display: Display,
    camera: Camera,
    accepted: Accepted,
    *,
    time: Time,
    clock: ClockMap,
    seed: int = 0,
    flips: int = _FLIPS,
    triggered: bool = False,
) -> tuple[Timing, FlipRecord]:
    """Measure with frame 0 (black) and frame 1 (white) of `display` and a camera that runs; 60 flips, 5 s.

    accepted: the camera's settings. InputError where the camera does not see the display.
    """
    taken = _record_flips(display, Arrivals(camera, time, clock, triggered, None, display), seed, flips)
    return fit_timing(taken, accepted, display.refresh_s), taken


def _record_flips(display: Display, arrivals: Arrivals, seed: int, flips: int) -> FlipRecord:
    """Flip black and white every 2 to 6 refreshes, at random, and keep the brightness of every image."""
    refresh, now = display.refresh_s or _REFRESH_S, arrivals.time.now
    rng = np.random.default_rng(seed)
    bands = _Bands(_still(display, 0, arrivals), _still(display, 1, arrivals))
    white: list[float] = []
    for image, _ in arrivals.until(now() + _PATIENCE_S):
        white += [float(np.nanmean(bands(image.pixels)))] if image.complete else []
        if len(white) == _WHITE_IMAGES:
            break
    rows: list[Floats] = []
    times: list[tuple[float, float, float]] = []

    def watch(until: float) -> None:
        for image, stamp in arrivals.until(until):
            if image.complete:
                rows.append(bands(image.pixels))
                times.append((stamp.time_s, stamp.sigma_s, image.arrived_s - stamp.time_s))

    level, swaps = 1, [display.show(1)]
    for _ in range(flips):
        watch(swaps[-1].swapped_s + (int(rng.integers(2, 7)) - 0.5) * refresh)
        level = 1 - level
        swaps.append(display.show(level))
    watch(now() + _STILL_S)
    stamps, sigmas, delays = np.array(times).reshape(-1, 3).T
    return FlipRecord(
        stamps,
        float(np.median(sigmas)) if len(sigmas) else 0.0,
        np.array(rows),
        bands.middles,
        np.array([shown.swapped_s for shown in swaps]),
        np.array([float(shown.index) for shown in swaps]),
        delays,
        flicker=float(np.std(white) / np.mean(white)) if white else 0.0,
    )


def _still(display: Display, level: int, arrivals: Arrivals) -> Floats:
    """The display at one level, half a second after its swap or later. InputError if no images come."""
    now = arrivals.time.now
    display.show(level)
    limit, seen = now() + _PATIENCE_S, list[Floats]()
    while len(seen) < 2 and now() < limit:
        images = (image for image, _ in arrivals.until(now() + _STILL_S))
        seen += [np.asarray(image.pixels, np.float64) for image in images if image.complete]
    if len(seen) < 2:
        raise InputError("camera: fewer than 2 complete images in 5 s; is it running, is it triggered?")
    return seen[-1]


class _Bands:
    """Mean brightness of the lit pixels in bands of rows."""

    def __init__(self, black: Floats, white: Floats) -> None:
        swing = white - black
        top = float(np.percentile(swing, 99.5))
        if top < _SWING:
            raise InputError(
                f"camera: white is {top:.1f} levels above black, must be {_SWING:g} or more; does the camera "
                "see the display? is the exposure long enough (optolever camera expose)?"
            )
        lit = swing > _LIT * top
        count = min(_BANDS, len(lit))
        edges = np.linspace(0, len(lit), count + 1).astype(int)
        parts = [slice(a, b) for a, b in pairwise(edges) if lit[a:b].any()]
        self._parts = [(part, lit[part]) for part in parts]
        self.middles = np.array([self._middle(part, lit[part], len(lit)) for part in parts])

    @staticmethod
    def _middle(part: slice, lit: NDArray[np.bool_], rows: int) -> float:
        return float((part.start + lit.sum(axis=1) @ (np.arange(len(lit)) + 0.5) / lit.sum()) / rows)

    def __call__(self, pixels: NDArray[np.number]) -> Floats:
        return np.array([pixels[part][lit].mean() for part, lit in self._parts])


def fit_timing(taken: FlipRecord, accepted: Accepted, refresh_s: float | None) -> Timing:
    """The Timing that explains the brightness best. InputError of fewer images than numbers."""
    if len(taken.stamps_s) < 20:
        raise InputError(f"sync: {len(taken.stamps_s)} images while the screen flipped, must be at least 20")
    exposure = accepted.exposure_s
    found, misfit, slopes = _fit(taken, exposure, taken.swaps_s, None)
    late = np.zeros(len(taken.swaps_s))
    for _ in range(_ROUNDS):  # late swaps bend the fit, and the fit the lateness
        late = _lateness(taken, exposure, found, late)
        swaps = taken.swaps_s + np.where(np.abs(late) > _LATE_S, late, 0.0)
        found, misfit, slopes = _fit(taken, exposure, swaps, found)
    latency, rise, fall, shutter = (float(value) for value in found)
    freedom = max(misfit.size - 4 - 2 * len(taken.bands), 1)
    scatter = max(float(np.sqrt(misfit @ misfit / freedom)), _LEAST_SCATTER)
    ranges = np.diag(scatter * np.sqrt(12) / (_HIGHEST - _LOWEST))  # of an unseen number: its bounds'
    factor = np.linalg.qr(np.vstack([slopes, ranges]), mode="r")
    formal = scatter * np.linalg.norm(np.linalg.inv(factor), axis=1)
    sigma = dict(zip(("latency", "rise", "fall", "shutter"), map(float, formal), strict=True))
    sigma["latency"] = float(np.hypot(sigma["latency"], taken.sigma_s))
    period = float(np.median(np.diff(taken.stamps_s)))
    read_out = float(np.median(taken.delays_s)) - exposure - abs(shutter)
    return Timing(
        latency_s=latency,
        jitter_s=max(0.0, float(late[1:].max()) + 0.5 * _LATENESS_STEP_S),
        rise_s=rise,
        fall_s=fall,
        shutter_s=shutter,
        read_out_s=max(read_out, 0.0),
        period_s=period,
        exposure_s=exposure,
        refresh_s=refresh_s,
        misfit=float(np.sqrt(np.mean(misfit**2))),
        flicker=taken.flicker,
        bits=accepted.bits,
        trigger=accepted.trigger,
        sigma_s=sigma,
    )


def _scaled(brightness: Floats, model: Floats) -> Floats:
    """Brightness (N, ...) by its best gain and offset on the model's light."""
    centred, off = model - model.mean(axis=0), brightness - brightness.mean(axis=0)
    gain = (centred * off).sum(axis=0) / np.maximum((centred**2).sum(axis=0), 1e-12)
    scaled: Floats = model.mean(axis=0) + off / gain
    return scaled


def sync_notices(timing: Timing) -> tuple[Notice, ...]:
    """Faults of a measured synchronisation."""
    found = []
    if timing.misfit > _MISFIT:
        found.append(
            Notice(
                "The display's light does not settle exponentially; rms residual over the swing",
                timing.misfit,
                _MISFIT,
                "most likely dynamic backlight or overdrive: switch it off, then optolever camera sync again",
            )
        )
    sigma = timing.sigma_s or {}
    unseen = max(sigma.get("rise", 0.0), sigma.get("fall", 0.0))
    if unseen > _UNSEEN_S:
        found.append(
            Notice(
                "Few images show how the display's cells settle, so that capture waits longer; sigma, ms",
                1e3 * unseen,
                1e3 * _UNSEEN_S,
                "end other programs, then optolever camera sync again",
            )
        )
    whole = timing.whole_refreshes(timing.exposure_s)
    if whole is not None and abs(whole - timing.exposure_s) > 1e-3 * whole:
        found.append(
            Notice(
                f"The exposure is {timing.exposure_s / (timing.refresh_s or 1):.3g} refreshes, so that the "
                "display flickers in it",
                float("nan"),
                float("nan"),
                f"expose for whole refreshes: --set exposure_ms={1e3 * whole:.3f}",
            )
        )
    return tuple(found)


def _starts(numbers: Floats, taken: FlipRecord) -> Floats:
    """Starts of the exposures (N, B), on the time of swaps."""
    return np.asarray(taken.stamps_s[:, None] + numbers[3] * taken.bands - numbers[0])


def _light(numbers: Floats, taken: FlipRecord, exposure: float, swaps: Floats) -> Floats:
    """Mean light (N, B) over the exposures; numbers: latency, rise, fall, shutter."""
    levels, starts = taken.levels, _starts(numbers, taken)
    taus = np.where(levels > 0.5, numbers[1], numbers[2])
    steps = np.maximum(np.diff(swaps), 0.0)
    gone = -np.expm1(-steps / taus[:-1])
    states = np.empty(len(swaps))  # at every swap
    states[0] = levels[0]
    for k in range(len(steps)):
        states[k + 1] = levels[k] + (states[k] - levels[k]) * (1 - gone[k])
    parts = levels[:-1] * steps + (states - levels)[:-1] * taus[:-1] * gone
    totals = np.concatenate([[0.0], np.cumsum(parts)])

    def integral(times: Floats) -> Floats:
        k = np.maximum(np.searchsorted(swaps, times, side="right") - 1, 0)
        since = times - swaps[k]
        gone = -np.expm1(-np.maximum(since, 0.0) / taus[k])
        return np.asarray(totals[k] + levels[k] * since + (states[k] - levels[k]) * taus[k] * gone)

    return (integral(starts + exposure) - integral(starts)) / exposure


def _residual(numbers: Floats, taken: FlipRecord, exposure: float, swaps: Floats) -> Floats:
    """Brightness less the model's best gain and offset of each band, over the swing; (N B,)."""
    model = _light(numbers, taken, exposure, swaps)
    model = model - model.mean(axis=0)
    seen = taken.brightness - taken.brightness.mean(axis=0)
    gain = (model * seen).sum(axis=0) / np.maximum((model**2).sum(axis=0), 1e-12)
    return np.asarray(((seen - gain * model) / np.ptp(taken.brightness, axis=0)).ravel())


def _fit(
    taken: FlipRecord, exposure: float, swaps: Floats, start: Floats | None
) -> tuple[Floats, Floats, Floats]:
    """Numbers, residuals, derivatives: least squares from `start`, else from the best of a grid of latencies,
    cells and shutters."""

    def cost(numbers: Floats) -> float:
        return float(np.sum(_residual(numbers, taken, exposure, swaps) ** 2))

    starts = [start] if start is not None else []
    if start is None:
        grid = [
            np.array([latency, _CELLS_S, _CELLS_S, shutter])
            for latency in _LATENCIES
            for shutter in (-0.015, 0.0, 0.015)
        ]
        starts = sorted(grid, key=cost)[:3]
    fits = [
        scipy.optimize.least_squares(
            _residual,
            one,
            args=(taken, exposure, swaps),
            x_scale=1e-3,
            bounds=(_LOWEST, _HIGHEST),
        )
        for one in starts
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    return best.x, best.fun, best.jac


def _lateness(taken: FlipRecord, exposure: float, numbers: Floats, lateness: Floats) -> Floats:
    """(F,) s, delay of each swap's light relative to the fit, one after the other, given the others'
    estimates; 0 where that explains no more than chance does."""
    swaps, found, starts = taken.swaps_s + lateness, lateness.copy(), _starts(numbers, taken)
    model = _light(numbers, taken, exposure, swaps)
    seen = _scaled(taken.brightness, model)
    noise = float(np.mean((model - seen) ** 2))
    reach = exposure + 5 * float(max(numbers[1], numbers[2])) + float(_LATENESS[-1])
    for k in range(1, len(swaps)):
        planned, last = taken.swaps_s[k], swaps[k + 1] if k + 1 < len(swaps) else np.inf
        near = ((starts > planned - exposure + _LATENESS[0]) & (starts < planned + reach)).any(axis=1)
        if not near.any():
            continue
        some = replace(taken, stamps_s=taken.stamps_s[near])
        tried = np.clip(planned + np.append(_LATENESS, 0.0), swaps[k - 1], last)
        costs = []
        for swaps[k] in tried:
            costs.append(np.sum((_light(numbers, some, exposure, swaps) - seen[near]) ** 2))
        best = int(np.argmin(costs[:-1]))
        found[k] = _LATENESS[best] if costs[-1] - costs[best] >= _CERTAIN * noise else 0.0
        swaps[k] = min(max(planned + found[k], swaps[k - 1]), last)
    return found
