"""Drawn captures by the definitions of the codes: mirrors, cards at several depths, light of cameras."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.patterns import Sequence, sequence_from_text

from ..figures.ideal import ideal_level

__all__ = ["CODES", "LIGHTS", "Drawn", "Light", "draw"]

CODES = (
    "gray+phase", "phase", "gray", "gray:inverses=false", "gray+phase:inverses=true", "phase:steps=3",
    "gray+phase:axes=u",
)  # fmt: skip
#: Of the pattern (rows, cols) and of the camera; samples of a pixel along an axis.
_SURFACE, _SIZE, _FINE = (216, 288), (120, 160), 4
_SHAPES = ("mirror", "dent", "cards")


@dataclass(frozen=True)
class Light:
    """lens: rms blur, px; electrons: a level; read: noise, levels; lag, flicker: shares; gamma: of the
    display; white: level above black; dark: share of the rows that see nothing."""

    lens: float = 0.3
    electrons: float = 30.0
    read: float = 0.8
    lag: float = 0.0
    flicker: float = 0.0
    gamma: float = 1.0
    white: float = 190.0
    dark: float = 0.0


LIGHTS = {
    "clean": Light(),
    "lag 20 %": Light(lag=0.2),
    "flicker 5 %": Light(flicker=0.05),
    "10 electrons a level": Light(electrons=10.0),
    "soft focus": Light(lens=1.2),
    "gamma 2.2": Light(gamma=2.2),
    "half in the dark": Light(dark=0.5),
    "weak light": Light(white=25.0),
    "clips": Light(white=300.0),
}


@dataclass(frozen=True, eq=False)
class Drawn:
    """frames (N, H, W) as `sequence` describes them; where every pixel looks (H, W); lit (H, W)."""

    frames: NDArray[np.uint8]
    sequence: Sequence
    truth: tuple[Floats, Floats]
    lit: NDArray[np.bool_]


def draw(code: str, light: Light, seed: int) -> Drawn:
    """A scene by its seed, of each shape in turn."""
    rng = np.random.default_rng(seed)
    shown = sequence_from_text(code, *_SURFACE)
    fine = tuple(_FINE * one for one in _SIZE)
    u, v, albedo = _scene(_SHAPES[seed % len(_SHAPES)], fine, rng)
    frames = np.empty((len(shown), *_SIZE), np.float64)
    for i in range(len(shown)):
        level: Floats = albedo * ideal_level(shown, i, u, v) ** light.gamma
        if light.lens:
            level = np.asarray(cv2.GaussianBlur(level, (0, 0), _FINE * light.lens), np.float64)
        frames[i] = _pixels(level)
    frames *= 1 + light.flicker * rng.standard_normal((len(shown), 1, 1))
    for i in reversed(range(1, len(shown))):
        frames[i] += light.lag * (frames[i - 1] - frames[i])
    dark = round(light.dark * _SIZE[0])
    frames[:, :dark] = 0.0
    frames = 8 + light.white * frames
    spread = np.sqrt(light.read**2 + np.maximum(frames - 8, 0) / light.electrons)
    frames = frames + spread * rng.standard_normal(frames.shape)
    fine_u = u.reshape(_SIZE[0], _FINE, _SIZE[1], _FINE)
    lit = (_pixels(albedo) > 0.3) & (np.ptp(fine_u, axis=(1, 3)) < 6)  # at a rim two places mix
    lit[: dark + 2 if dark else 0] = False
    return Drawn(np.clip(np.rint(frames), 0, 255).astype(np.uint8), shown, (_pixels(u), _pixels(v)), lit)


def _pixels(fine: Floats) -> Floats:
    rows, cols = _SIZE
    return np.asarray(fine.reshape(rows, _FINE, cols, _FINE).mean(axis=(1, 3)))


def _scene(shape: str, size: tuple[int, ...], rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """u, v, pattern px, and albedo, on a fine grid."""
    row, col = (np.mgrid[: size[0], : size[1]] + rng.uniform(0, 1, (2, *size))) / _FINE - 0.5
    scale, turn = rng.uniform(1.2, 1.6), rng.uniform(-0.1, 0.1)
    x, y = col - _SIZE[1] / 2, row - _SIZE[0] / 2
    u = _SURFACE[1] / 2 + scale * (x + turn * y) + 4 * np.sin(row / 31 + rng.uniform(0, 6))
    v = _SURFACE[0] / 2 + scale * (y - turn * x) + 4 * np.cos(col / 27 + rng.uniform(0, 6))
    albedo = np.ones(size) * (1 - 0.2 * (x / 80) ** 2)
    if shape == "dent":
        slope = 6 * np.exp(0.5 - ((x + 10) ** 2 + y**2) / 800)
        u, v = u + slope * (x + 10) / 20, v + slope * y / 20
    if shape == "cards":
        for _ in range(6):
            cx, cy = rng.uniform(-70, 70), rng.uniform(-50, 50)
            card = (np.abs(x - cx) < rng.uniform(12, 35)) & (np.abs(y - cy) < rng.uniform(10, 30))
            u = np.where(card, u + rng.uniform(-12, 12), u)
            albedo = np.where(card, rng.uniform(0.35, 1.0), albedo)
    return u, v, albedo
