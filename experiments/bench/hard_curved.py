"""Drawn mirrors that bend inside of a pixel: relief, ripples, ridges, balls, seen by rays through its area.

What a pixel reads is a mean; a Correspondence means the place that its centre sees.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from optolever.scene import Scene, Sensor, Surface, dent, load, resize, trace

from ..drawn import together
from .found import Found
from .hard_case import Case
from .hard_drawn import AREA_PIXELS, AREA_SHARE, decoded_area, drawn_size
from .rigs import KINDS, draw_rig

__all__ = ["CURVED_CODES", "FORMS", "curved_cases", "curved_scene"]

Float = NDArray[np.float64]

CURVED_CODES = "gray+phase", "phase", "micro-phase", "gray"
FORMS = "relief", "ripples", "ridge", "ball"
_SEED = 4711
_SIZES = 160, 300  # rows and columns of a camera: from, below
_NOISES = 0.3, 1.0, 2.0  # rms levels
_STEEPEST = np.radians(4.2)
_WAVE = 3.0  # pixels


def curved_cases(scenes: int, first: int = 0) -> Iterator[Case]:
    """Every code on so many drawn scenes: in turn a form of dent each; four in the preset, four on rigs."""
    for number in range(first, first + scenes):
        _, size, noise = _drawn(number)
        for code in CURVED_CODES:
            yield Case(
                *("curved", f"{FORMS[number % len(FORMS)]} {number}", code, size),
                partial(curved_found, number, code),
                noise,
                "uint8",
                share=AREA_SHARE,
                pixels=AREA_PIXELS,
            )


def curved_scene(number: int) -> tuple[Scene, Surface, Sensor]:
    """The scene of a number, always the same."""
    rng, size, noise = _drawn(number)
    if number // len(FORMS) % 2:
        scene = draw_rig(rng, str(rng.choice(KINDS)), size).scene
    else:
        scene = resize(load("prism48"), *size)
    draw = (_relief, _ripples, _ridge, _ball)[number % len(FORMS)]
    return scene, draw(rng, scene), Sensor(noise=noise)


def curved_found(number: int, code: str) -> Found:
    """Render, decode, compare."""
    scene, surface, sensor = curved_scene(number)
    return decoded_area(scene, surface, code, sensor, number)


def _drawn(number: int) -> tuple[np.random.Generator, tuple[int, int], float]:
    """Random numbers of a scene, its camera's size and noise."""
    rng = np.random.default_rng([_SEED, number])
    return rng, drawn_size(rng, _SIZES), float(rng.choice(_NOISES))


def _relief(rng: np.random.Generator, scene: Scene) -> Surface:
    """Ten to forty bumps and hollows."""
    length, width = scene.mirror.length, scene.mirror.width
    count = int(rng.integers(10, 40))
    sigma = length * rng.uniform(0.015, 0.08, count)
    x0, y0 = length * rng.uniform(0.1, 0.8, count), width * rng.uniform(0.1, 0.9, count)
    peak = np.radians(rng.uniform(-1.5, 1.5, count)) * sigma
    bumps = [
        partial(dent, "gaussian", x=x, y=y, sigma=width, peak=height)
        for x, y, width, height in zip(x0, y0, sigma, peak, strict=True)
    ]
    return together(bumps, scene)


def _ripples(rng: np.random.Generator, scene: Scene) -> Surface:
    """A plane wave of 3 to 15 % of the mirror's length, that fades out towards x = L0; at least _WAVE pixels
    long (shorter ones alias: no pixels of a camera tell them from long ones)."""
    length = scene.mirror.length
    wave = 2 * np.pi / max(length * rng.uniform(0.03, 0.15), _WAVE * _pixel(scene))
    angle = rng.uniform(0, np.pi)
    kx, ky = wave * np.cos(angle), wave * np.sin(angle)
    size = np.radians(rng.uniform(0.3, 2.0)) / wave

    def fade(x: Float) -> tuple[Float, Float]:
        t = np.clip((length - x) / (0.1 * length), 0.0, 1.0)
        return t**3 * (10 - 15 * t + 6 * t * t), -30 * t * t * (1 - t) ** 2 / (0.1 * length)

    def height(x: Float, y: Float) -> Float:
        return np.asarray(size * fade(x)[0] * (1 + np.cos(kx * x + ky * y)))

    def gradient(x: Float, y: Float) -> tuple[Float, Float]:
        share, change = fade(x)
        up, across = 1 + np.cos(kx * x + ky * y), -np.sin(kx * x + ky * y)
        return size * (change * up + share * kx * across), size * share * ky * across

    return Surface(height, gradient)


def _pixel(scene: Scene) -> float:
    """Distance of neighbouring pixels on the mirror at rest, mm: the larger one of both axes, median."""
    rest = trace(scene, dent("flat", scene))
    points = np.stack([rest.x, rest.y])
    steps = [np.hypot(*np.diff(points, axis=axis)) for axis in (1, 2)]
    return float(max(np.nanmedian(step) for step in steps))


def _ridge(rng: np.random.Generator, scene: Scene) -> Surface:
    """1 to 4.2 degrees steep."""
    length = scene.mirror.length
    sigma = length * rng.uniform(0.01, 0.05)
    peak = np.radians(rng.uniform(1.0, 4.2)) * sigma * np.exp(0.5)
    place = {"x": rng.uniform(0.3, 0.7) * length, "angle_deg": rng.uniform(0, 90)}
    return dent("ridge", scene, peak=peak, sigma=sigma, **place)


def _ball(rng: np.random.Generator, scene: Scene) -> Surface:
    """Its contact has an edge at which the slope jumps."""
    length, width = scene.mirror.length, scene.mirror.width
    contact = rng.uniform(0.03, 0.12) * min(length, width)
    peak = contact * rng.uniform(np.tan(np.radians(1.0)), np.tan(_STEEPEST))
    place = {"x": rng.uniform(0.3, 0.7) * length, "y": rng.uniform(0.3, 0.7) * width}
    return dent("ball", scene, peak=peak, radius=contact**2 / peak, **place)
