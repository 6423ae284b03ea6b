"""Latency, settling and shutter of a display and a camera, measured by full-screen flips.

The camera is the photodiode: brightness of bands of rows against the times of pseudo-random swaps. Band r
(0 top, 1 bottom) of an image with stamp s is the mean over [s + r shutter, + exposure] of cells that follow
every swap `latency` later, with separate time constants for rise and fall. Four numbers, a gain and an
offset per band; least squares.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar

from optolever.errors import InputError
from optolever.notices import Notice

from .clocks import ClockMap, Stamp
from .devices import Accepted, Camera, Display, Image, Time
from .timing import Timing

__all__ = [
    "FlipFit",
    "FlipRecord",
    "fit_timing",
    "flip_fit",
    "record_flips",
    "sync_notices",
    "synchronise",
]

Float = NDArray[np.float64]

_BANDS = 16
_FLIPS = 60
_REFRESH_S = 1 / 60  # assumed where unknown: unit of the time between flips
_WHITE_IMAGES = 32
_STILL_S, _PATIENCE_S = 0.5, 5.0  # after a swap until the light is still; until an image must have come
_LIT = 0.3  # of the largest swing: pixels that see the display
_SWING = 8.0  # levels, at least
_LATENCIES = np.arange(-0.02, 0.3, 0.004)
_CELLS_S = 0.005  # time constant of cells that a fit starts from
_LATENESS = np.arange(-0.01, 0.0605, 0.0005)
_STRIDE = 4
_CERTAIN = 16.0  # squared residuals, in their variance, that a late swap explains
_LATE_S = 0.004  # a swap whose light is later than the others' by more does not count in the fit
_MISFIT = 0.03
_ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class FlipRecord:
    """stamps_s (N,) and their sigma; brightness (N, B) of bands with middles `bands` (0 to 1); swaps_s (F,)
    and the level (0 or 1) after each; delays_s (N,) from stamp to arrival; flicker: of white images.
    """

    stamps_s: Float
    sigma_s: float
    brightness: Float
    bands: Float
    swaps_s: Float
    levels: Float
    delays_s: Float
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
    taken = record_flips(display, camera, time=time, clock=clock, seed=seed, flips=flips, triggered=triggered)
    return fit_timing(taken, accepted, display.refresh_s), taken


def record_flips(
    display: Display,
    camera: Camera,
    *,
    time: Time,
    clock: ClockMap,
    seed: int = 0,
    flips: int = _FLIPS,
    triggered: bool = False,
) -> FlipRecord:
    """Flip black and white every 2 to 6 refreshes, at random, and keep the brightness of every image."""
    refresh = display.refresh_s or _REFRESH_S
    rng = np.random.default_rng(seed)
    eye = _Eye(camera, time, clock, triggered)
    bands = _Bands(_still(display, 0, eye), _still(display, 1, eye))
    flicker = _flicker(eye, bands)
    rows: list[Float] = []
    times: list[tuple[float, float, float]] = []

    def watch(until: float) -> None:
        for image, stamp in eye.images(until):
            rows.append(bands(image.pixels))
            times.append((stamp.time_s, stamp.sigma_s, image.arrived_s - stamp.time_s))

    level, swaps = 1, [display.show(1)]
    for _ in range(flips):
        watch(swaps[-1].swapped_s + (int(rng.integers(2, 7)) - 0.5) * refresh)
        level = 1 - level
        swaps.append(display.show(level))
    watch(time.now() + _STILL_S)
    stamps, sigmas, delays = (np.array(column) for column in zip(*times, strict=True))
    return FlipRecord(
        stamps,
        float(np.median(sigmas)),
        np.array(rows),
        bands.middles,
        np.array([shown.swapped_s for shown in swaps]),
        np.array([float(shown.index) for shown in swaps]),
        delays,
        flicker,
    )


@dataclass(frozen=True, slots=True)
class _Eye:
    """A camera that runs, or waits for triggers, and the clocks."""

    camera: Camera
    time: Time
    clock: ClockMap
    triggered: bool

    def images(self, until: float) -> Iterator[tuple[Image, Stamp]]:
        """Complete images and their times, up to a time."""
        while (left := until - self.time.now()) > 0:
            if self.triggered:
                self.camera.trigger()
            image = self.camera.next(left)
            if image is not None:
                stamp = self.clock.stamp(image)
                if image.complete:
                    yield image, stamp


def _still(display: Display, level: int, eye: _Eye) -> Float:
    """The display at one level, half a second after its swap or later. InputError if no images come."""
    display.show(level)
    limit, count, last = eye.time.now() + _PATIENCE_S, 0, None
    while count < 2 and eye.time.now() < limit:
        for image, _ in eye.images(eye.time.now() + _STILL_S):
            count, last = count + 1, image
    if last is None or count < 2:
        raise InputError("camera: fewer than 2 complete images in 5 s; is it running, is it triggered?")
    return np.asarray(last.pixels, np.float64)


def _flicker(eye: _Eye, bands: _Bands) -> float:
    """Standard deviation of white images over their mean; 0 if none comes."""
    white: list[float] = []
    for image, _ in eye.images(eye.time.now() + _PATIENCE_S):
        white.append(float(np.nanmean(bands(image.pixels))))
        if len(white) == _WHITE_IMAGES:
            break
    return float(np.std(white) / np.mean(white)) if white else 0.0


class _Bands:
    """Mean brightness of the lit pixels in bands of rows."""

    def __init__(self, black: Float, white: Float) -> None:
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

    def __call__(self, pixels: NDArray[np.number]) -> Float:
        return np.array([pixels[part][lit].mean() for part, lit in self._parts])


def fit_timing(taken: FlipRecord, accepted: Accepted, refresh_s: float | None) -> Timing:
    """The Timing that explains the brightness best. InputError of fewer images than numbers."""
    if len(taken.stamps_s) < 20:
        raise InputError(f"sync: {len(taken.stamps_s)} images while the screen flipped, must be at least 20")
    exposure = accepted.exposure_s
    fit = _fit(taken, exposure, taken.swaps_s, None)
    lateness = np.zeros(len(taken.swaps_s))
    for _ in range(_ROUNDS):  # late swaps bend the fit, and the fit the lateness
        lateness = _lateness(taken, exposure, fit.x, lateness)
        late = np.where(np.abs(lateness) > _LATE_S, lateness, 0.0)
        fit = _fit(taken, exposure, taken.swaps_s + late, fit.x)
    latency, rise, fall, shutter = (float(value) for value in fit.x)
    freedom = max(fit.fun.size - 4 - 2 * len(taken.bands), 1)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * float(fit.fun @ fit.fun) / freedom
    formal = np.sqrt(np.diag(covariance))
    sigma = dict(zip(("latency", "rise", "fall", "shutter"), map(float, formal), strict=True))
    sigma["latency"] = float(np.hypot(sigma["latency"], taken.sigma_s))
    period = float(np.median(np.diff(taken.stamps_s)))
    read_out = float(np.median(taken.delays_s)) - exposure - abs(shutter)
    return Timing(
        latency_s=latency,
        jitter_s=max(0.0, float(lateness[1:].max()) + 0.5 * float(_LATENESS[1] - _LATENESS[0])),
        rise_s=rise,
        fall_s=fall,
        shutter_s=shutter,
        read_out_s=max(read_out, 0.0),
        period_s=period,
        exposure_s=exposure,
        refresh_s=refresh_s,
        misfit=float(np.sqrt(np.mean(fit.fun**2))),
        flicker=taken.flicker,
        bits=accepted.bits,
        trigger=accepted.trigger,
        sigma_s=sigma,
    )


@dataclass(frozen=True, slots=True, eq=False)
class FlipFit:
    """A Timing against its record. lateness_s (F - 1,): light of every swap after the first, relative to the
    others; since_s (N, B): from the light of a swap to the start of a band's exposure; light, model (N, B):
    measured and predicted, 0 black to 1 white; rising (N, B): whether that swap was to white; begins_s (B,):
    start of every band's exposure after the first row's, each fitted alone.
    """

    lateness_s: Float
    since_s: Float
    light: Float
    model: Float
    rising: NDArray[np.bool_]
    begins_s: Float


def flip_fit(taken: FlipRecord, timing: Timing) -> FlipFit:
    """How well a Timing explains its record, for a page: nothing of it enters a capture."""
    exposure, pair = timing.exposure_s, np.array([timing.rise_s, timing.fall_s])
    numbers = np.array([timing.latency_s, *pair, timing.shutter_s])
    late = np.zeros(len(taken.swaps_s))
    for _ in range(_ROUNDS):
        late = _lateness(taken, exposure, numbers, late)
    swaps = taken.swaps_s + late
    starts = taken.stamps_s[:, None] + timing.shutter_s * taken.bands - timing.latency_s
    model = _light(pair, starts, exposure, swaps, taken.levels)
    k = np.maximum(np.searchsorted(swaps, starts + exposure, side="right") - 1, 0)

    def cost(begin: float, band: int) -> float:
        one = taken.stamps_s + begin - timing.latency_s
        light = _light(pair, one, exposure, swaps, taken.levels)
        return float(np.sum((_scaled(taken.brightness[:, band], light) - light) ** 2))

    limits = (-abs(timing.shutter_s) - _LATE_S, abs(timing.shutter_s) + _LATE_S)
    begins = [
        minimize_scalar(cost, bounds=limits, args=(band,), method="bounded").x
        for band in range(len(taken.bands))
    ]
    light = _scaled(taken.brightness, model)
    return FlipFit(late[1:], starts - swaps[k], light, model, taken.levels[k] > 0.5, np.array(begins))


def _scaled(brightness: Float, model: Float) -> Float:
    """Brightness (N, ...) by its best gain and offset on the model's light."""
    centred, off = model - model.mean(axis=0), brightness - brightness.mean(axis=0)
    gain = (centred * off).sum(axis=0) / np.maximum((centred**2).sum(axis=0), 1e-12)
    scaled: Float = model.mean(axis=0) + off / gain
    return scaled


def sync_notices(timing: Timing) -> tuple[Notice, ...]:
    """Faults of a measured synchronisation."""
    found = []
    if timing.misfit > _MISFIT:
        found.append(
            Notice(
                "the display does not follow the model of exponential cells (rms of the light, of the swing)",
                timing.misfit,
                _MISFIT,
                "switch off dynamic backlight, overdrive and dithering, or capture without [sync]",
            )
        )
    whole = timing.whole_refreshes(timing.exposure_s)
    if whole is not None and abs(whole - timing.exposure_s) > 1e-3 * whole:
        found.append(
            Notice(
                f"the exposure is {timing.exposure_s / (timing.refresh_s or 1):.3g} refreshes of the display",
                float("nan"),
                float("nan"),
                f"expose for {1e3 * whole:.3f} ms, else its refresh beats with the camera",
            )
        )
    return tuple(found)


def _light(numbers: Float, starts: Float, exposure: float, swaps: Float, levels: Float) -> Float:
    """Mean light over [starts, starts + exposure] of cells after swaps at `swaps`; numbers: rise, fall."""
    rise, fall = numbers
    state, total = float(levels[0]), 0.0
    states, totals = np.empty(len(swaps)), np.empty(len(swaps))
    taus = np.where(levels > 0.5, rise, fall)
    for k, (level, tau) in enumerate(zip(levels, taus, strict=True)):
        states[k], totals[k] = state, total
        if k + 1 < len(swaps):
            step = max(swaps[k + 1] - swaps[k], 0.0)
            gone = -np.expm1(-step / tau)
            total += level * step + (state - level) * tau * gone
            state = level + (state - level) * (1 - gone)

    def integral(times: Float) -> Float:
        k = np.maximum(np.searchsorted(swaps, times, side="right") - 1, 0)
        since = times - swaps[k]
        gone = -np.expm1(-np.maximum(since, 0.0) / taus[k])
        found: Float = totals[k] + levels[k] * since + (states[k] - levels[k]) * taus[k] * gone
        return found

    mean: Float = (integral(starts + exposure) - integral(starts)) / exposure
    return mean


def _residual(numbers: Float, taken: FlipRecord, exposure: float, swaps: Float) -> Float:
    """Brightness less the model's best gain and offset of each band, over the gain; (N B,)."""
    latency, rise, fall, shutter = numbers
    starts = taken.stamps_s[:, None] + shutter * taken.bands
    model = _light(np.array([rise, fall]), starts - latency, exposure, swaps, taken.levels)
    model = model - model.mean(axis=0)
    seen = taken.brightness - taken.brightness.mean(axis=0)
    gain = (model * seen).sum(axis=0) / np.maximum((model**2).sum(axis=0), 1e-12)
    swing = np.ptp(taken.brightness, axis=0)
    residual: Float = ((seen - gain * model) / swing).ravel()
    return residual


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Latency, rise, fall, shutter; residuals and their derivatives there."""

    x: Float
    fun: Float
    jac: Float


def _fit(taken: FlipRecord, exposure: float, swaps: Float, start: Float | None) -> _Fit:
    """Least squares from `start`, else from the best of a grid of latencies, cells and shutters."""

    def cost(numbers: Float) -> float:
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
        least_squares(
            _residual,
            one,
            args=(taken, exposure, swaps),
            x_scale=1e-3,
            bounds=([-0.1, 1e-4, 1e-4, -0.1], [0.5, 0.2, 0.2, 0.1]),
        )
        for one in starts
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    return _Fit(best.x, best.fun, best.jac)


def _lateness(taken: FlipRecord, exposure: float, numbers: Float, lateness: Float) -> Float:
    """(F,) s, delay of each swap's light relative to the fit; sequentially, given the others' estimates."""
    latency, rise, fall, shutter = numbers
    starts = taken.stamps_s[:, None] + shutter * taken.bands - latency
    swaps = taken.swaps_s + lateness
    pair = np.array([rise, fall])
    model = _light(pair, starts, exposure, swaps, taken.levels)
    seen = _scaled(taken.brightness, model)
    found = lateness.copy()
    noise = float(np.mean((_light(pair, starts, exposure, swaps, taken.levels) - seen) ** 2))
    reach = exposure + 5 * max(rise, fall) + _LATENESS[-1]
    for k in range(1, len(swaps)):
        planned = taken.swaps_s[k]
        near = ((starts > planned - exposure + _LATENESS[0]) & (starts < planned + reach)).any(axis=1)
        if not near.any():
            continue
        cost = partial(_moved_cost, k, swaps, taken.levels, pair, starts[near], seen[near], exposure)
        found[k] = _shift(cost, planned, noise)
        swaps[k] = _between(k, swaps, planned + found[k])
    return found


def _between(k: int, swaps: Float, moved: float) -> float:
    """A time of swap k, clipped to the swaps before and after it."""
    return float(min(max(moved, swaps[k - 1]), swaps[k + 1] if k + 1 < len(swaps) else np.inf))


def _moved_cost(
    k: int,
    swaps: Float,
    levels: Float,
    pair: Float,
    starts: Float,
    seen: Float,
    exposure: float,
    moved: float,
) -> float:
    """Squared misfit of images if swap k were at `moved`."""
    tried = swaps.copy()
    tried[k] = _between(k, swaps, moved)
    return float(np.sum((_light(pair, starts, exposure, tried, levels) - seen) ** 2))


def _shift(cost: Callable[[float], float], planned: float, noise: float) -> float:
    """The lateness of least cost; 0 where it explains no more than chance does."""

    def at(late: float) -> float:
        return cost(planned + late)

    coarse = min(_LATENESS[::_STRIDE].tolist(), key=at)
    reach = _STRIDE * float(_LATENESS[1] - _LATENESS[0]) + 1e-9
    best = min(_LATENESS[np.abs(_LATENESS - coarse) < reach].tolist(), key=at)
    return float(best) if at(0.0) - at(best) >= _CERTAIN * noise else 0.0
