"""Effects of display, camera, rig and frames, and a camera that sees a drawn rig under some of them.

The light is summed over rays within every pixel (projector.trace_area), without the decoder's model.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from optolever.experiments.ideal import Fault
from optolever.patterns import Sequence
from optolever.projector import AreaTrace, area_light
from optolever.scene import Display

from ..hard.drawn import between
from ..hard.rigs import Rig

Light = NDArray[np.float32]
Frames = NDArray[np.uint8]

#: Effects of light and of the rig by name, with the range that their size is drawn from: lag, gain, ghost and
#: sharpening: shares; shake: pattern px rms; gamma: exponent; row noise: levels rms; lens: camera px rms;
#: coarse: cells a camera pixel.
LIGHT = {
    "lag": (0.02, 0.1),
    "shake": (0.02, 0.1),
    "gain": (0.002, 0.02),
    "gamma": (1.1, 2.2),
    "ghost": (0.01, 0.06),
    "row noise": (0.3, 1.5),
    "lens": (0.3, 0.8),
    "sharpening": (0.3, 0.8),
    "coarse": (2.0, 6.0),
}
#: Faults of frames; a window covers a tenth of the picture in some of them.
FAULTS = ("swapped", "lost", "torn", "window")
APART = (37.3, 21.7)  # pattern px by which the second image of a ghost is off
COVERED = 0.1  # share of the picture before which a window stands
UNSHARP = 1.0  # px rms of the blur that an unsharp mask takes off
_PIVOT = 0.5


@dataclass(frozen=True, slots=True)
class Effect:
    """name: of LIGHT or FAULTS; size: as LIGHT says; frames: that a fault concerns, in the order shown."""

    name: str
    size: float = 0.0
    frames: tuple[int, ...] = ()

    def __str__(self) -> str:
        told = f" {self.size:.3g}" if self.name in LIGHT else ""
        return self.name + told + "".join(f" {i}" for i in self.frames)


@dataclass(frozen=True, slots=True)
class Camera:
    """Linear, 8 bits: levels of black and of light 1 above it, rms of the white noise."""

    black: float
    white: float
    noise: float


def drawn_camera(rng: np.random.Generator) -> Camera:
    """Black at 5 to 25, white up to 235, noise of half a level to two."""
    return Camera(float(rng.uniform(5, 25)), float(rng.uniform(110, 210)), between(rng, 0.5, 2.0))


def drawn_effect(rng: np.random.Generator, name: str, sequence: Sequence) -> Effect:
    """An effect of a size, or a fault of some frames."""
    if name in LIGHT:
        return Effect(name, between(rng, *LIGHT[name]))
    count = len(sequence)
    if name == "window":
        first = int(rng.integers(0, count - 1))
        frames = tuple(range(first, min(first + int(rng.integers(1, 9)), count)))
        return Effect(name, float(rng.choice([0.0, 0.97, 1.0])), frames)
    while True:
        frame = int(rng.integers(1, count - (name == "lost")))
        other = frame - 1 if rng.random() < 0.6 else int(rng.integers(count))
        if other != frame and not Fault("swapped", frame, other).inverts(sequence):
            return Effect(name, float(rng.uniform(0.25, 0.75)), (frame, other)[: 1 + (name != "lost")])


def finer(rig: Rig, per_pixel: float, seen: AreaTrace) -> Rig:
    """The rig with a pattern of so many cells a camera pixel."""
    moves = [
        np.hypot(np.diff(seen.centre.u, axis=axis), np.diff(seen.centre.v, axis=axis)) for axis in (0, 1)
    ]
    now = float(np.sqrt(np.nanmedian(moves[0]) * np.nanmedian(moves[1])))
    pattern, by = rig.scene.pattern, per_pixel / now
    rows, cols = (min(round(by * count), 4000) for count in (pattern.rows, pattern.cols))
    return replace(
        rig, scene=replace(rig.scene, pattern=pattern.resampled(rows, cols, by, _PIVOT * (by - 1)))
    )


def light_of_effects(
    area: AreaTrace, rig: Rig, shown: Sequence, effects: tuple[Effect, ...], rng: np.random.Generator
) -> Light:
    """Light (N, H, W) of frames as they come to the camera."""
    sizes = {one.name: one.size for one in effects}
    if "gamma" in sizes:
        area = replace(area, scene=replace(area.scene, display=Display(sizes["gamma"])))
    moves = sizes.get("shake", 0.0) * rng.standard_normal((len(shown), 2))
    light = _moved(area, rig, shown, moves - moves.mean(axis=0))
    if "ghost" in sizes:
        aside = replace(area, u=area.u + APART[0], v=area.v + APART[1])
        light = light + np.float32(sizes["ghost"]) * area_light(aside, shown, rig.lighting)
    if "lag" in sizes:
        light[1:] = (1 - sizes["lag"]) * light[1:] + sizes["lag"] * light[:-1]
    if "gain" in sizes:
        gains = 1 + sizes["gain"] * rng.standard_normal(len(shown))
        light = light * gains.astype(np.float32)[:, None, None]
    if "lens" in sizes:
        light = np.stack([_blurred(frame, sizes["lens"]) for frame in light])
    return np.asarray(light, np.float32)


def _moved(area: AreaTrace, rig: Rig, shown: Sequence, moves: NDArray[np.float64]) -> Light:
    """Of frames that are off by moves (N, 2), pattern px along u and v."""
    if not moves.any():
        return area_light(area, shown, rig.lighting)
    lights = []
    for i, (du, dv) in enumerate(moves):
        one = replace(shown, frames=shown.frames[i : i + 1])
        lights.append(area_light(replace(area, u=area.u + du, v=area.v + dv), one, rig.lighting))
    return np.concatenate(lights)


def _blurred(image: NDArray[Any], width: float) -> NDArray[Any]:
    """By a Gaussian of an rms width in pixels, exactly; mirrored beyond the image."""
    around = np.pad(image, 8, mode="symmetric")
    found = np.fft.irfft2(
        ndimage.fourier_gaussian(np.fft.rfft2(around), width, around.shape[1]), around.shape
    )
    return np.asarray(found[8:-8, 8:-8], np.float32)


def read(light: Light, camera: Camera, effects: tuple[Effect, ...], rng: np.random.Generator) -> Frames:
    """8-bit frames (N, H, W) of light (N, H, W)."""
    levels = np.asarray(camera.black + camera.white * light, np.float32)
    rows, cols = light.shape[1:]
    for one in effects:
        if one.name == "window":
            levels[list(one.frames), *_window(rng, rows, cols)] = camera.black + camera.white * one.size
    levels += camera.noise * rng.standard_normal(levels.shape, np.float32)
    for one in effects:
        if one.name == "row noise":
            levels += one.size * rng.standard_normal((len(levels), rows, 1), np.float32)
        elif one.name == "sharpening":
            soft = ndimage.gaussian_filter(levels, (0, UNSHARP, UNSHARP), mode="nearest")
            levels += np.float32(one.size) * (levels - soft)
    frames = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    for one in effects:
        if one.name in FAULTS and one.name != "window":
            other = one.frames[1] if len(one.frames) > 1 else 0
            frames = Fault(one.name, one.frames[0], other, one.size).spoil(frames)
    return frames


def _window(rng: np.random.Generator, rows: int, cols: int) -> tuple[slice, slice]:
    """Somewhere, of any shape up to 1 : 2."""
    height = round(rows * np.sqrt(COVERED) * rng.uniform(0.7, 1.4))
    width = round(COVERED * rows * cols / height)
    top, left = int(rng.integers(rows - height)), int(rng.integers(cols - width))
    return slice(top, top + height), slice(left, left + width)
