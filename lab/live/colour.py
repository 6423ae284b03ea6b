"""u in red and v in blue of one exposure, beside the crossed grey fringe: noise and resolution of the fit."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from optolever.arrays import Cells, Floats
from optolever.live.fringe.picture import Carriers, State, fit_step, to_cells, window_mean

__all__ = ["Shown", "shown"]

_LEVEL, _ELECTRONS = 100.0, 30.0  # of a grey picture; a level
_MIX = 0.12  # of two channels in a third one's
_STEPS, _DRAWS = 4, 6
_HEIGHT, _SIZE = 0.2, 3.0  # of a bump of displacement, turns, and its sigma, pixels
_WINDOWS = (0.5, 0.35)  # periods, rms: live's, and a shorter one


class Shown(NamedTuple):
    """What is shown, the window, periods; noise of displacements, mean of u and v, turns; share of a bump of
    3 pixels that the fit keeps; error of one of 12 pixels, turns."""

    name: str
    window: float
    noise: float
    kept: float
    error: float


def shown(carriers: Carriers, seed: int) -> Iterator[Shown]:
    """Grey; colours with a grey picture's light in each channel, and with a third of it."""
    for name, light in (
        ("grey", 0.0),
        ("colour, three times the light", 1.0),
        ("colour, equal light", 1 / 3),
    ):
        for window in _WINDOWS:
            here = _windowed(carriers, window)
            draws = [_fitted(here, 0.0, light, np.random.default_rng(seed + draw)) for draw in range(_DRAWS)]
            noise = float(np.std(draws, axis=0, ddof=1).mean())
            small, wide = (_fitted(here, size, light, None) for size in (_SIZE, 4 * _SIZE))
            true, broad = (_inner(_cells(here, _bump(here, size))) for size in (_SIZE, 4 * _SIZE))
            kept = float(np.mean([np.vdot(part, true) for part in small]) / np.vdot(true, true))
            yield Shown(name, window, noise, kept, float(np.std(wide - broad)))


def _windowed(carriers: Carriers, periods: float) -> Carriers:
    blur = carriers.spread * periods / _WINDOWS[0]
    taps = cv2.getGaussianKernel(2 * math.ceil(3.5 * blur) + 1, blur).astype(np.float32).ravel()
    return replace(carriers, window=taps, share=window_mean(to_cells(carriers.lit, carriers.cell), taps))


def _bump(carriers: Carriers, size: float) -> Floats:
    away = [np.arange(count) - count / 2 for count in carriers.lit.shape]
    return np.asarray(_HEIGHT * np.exp(-np.add.outer(*map(np.square, away)) / (2 * size**2)))


def _fitted(carriers: Carriers, size: float, light: float, rng: np.random.Generator | None) -> Floats:
    """Displacements u, v (2, r, c) of the inner cells, turns; light 0: grey; rng None: without noise."""
    bump = _bump(carriers, size) if size else 0.0
    u, v = (1 + np.cos(2 * np.pi * (turns + bump)) for turns in (carriers.turn_u, carriers.turn_v))
    if not light:
        return _solved(carriers, _noisy(_LEVEL * (u + v) / 2, rng), 0.5, 0.5, 1.0)
    mix = ((1 - 1.5 * _MIX) * np.eye(3) + _MIX / 2) * light
    seen = [
        _noisy(_LEVEL * sum(w * part for w, part in zip(row, (u, 1.0, v), strict=True)), rng) for row in mix
    ]
    red, _, blue = np.tensordot(light * np.linalg.inv(mix), np.stack(seen), 1)
    tiny = 1e-3
    both = _solved(carriers, red, 1.0, tiny, light)[0], _solved(carriers, blue, tiny, 1.0, light)[1]
    return np.stack(both)


def _noisy(light: Floats, rng: np.random.Generator | None) -> Floats:
    return light if rng is None else light + rng.normal(size=light.shape) * np.sqrt(light / _ELECTRONS)


def _solved(carriers: Carriers, picture: Floats, along: float, down: float, light: float) -> Floats:
    planes = np.zeros((5, *carriers.shape), np.float32)
    planes[2:] = _LEVEL * light * np.reshape([1.0, along, down], (3, 1, 1))
    state, seen = State(planes), carriers.by_columns(picture.astype(np.float32))
    for _ in range(_STEPS):
        state, _ = fit_step(carriers, seen, state)
    return _inner(state.displacement)


def _inner(field: Floats | Cells) -> Floats:
    rows, cols = (count // 4 for count in field.shape[-2:])
    return np.asarray(field[..., rows:-rows, cols:-cols], np.float64)


def _cells(carriers: Carriers, pixels: Floats) -> Floats:
    return np.asarray(to_cells(pixels.astype(np.float32), carriers.cell), np.float64)
