"""Three patterns in a picture against the same in grey: errors of places and heights, over sigma.

Light without noise comes from the virtual sensor; lag, flicker, photon noise and 8 bits are added here, so
that each exposure holds a share of the one before.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode
from optolever.patterns import STRIPES, Sequence, packed, sequence_from_text
from optolever.projector import (
    NOMINAL_SENSOR,
    Capture,
    ColourCapture,
    capture,
    capture_colour,
    exact_response,
)
from optolever.reconstruct import reconstruct
from optolever.scene import Display, Scene, Surface, dent_from_text, load, resize, trace

__all__ = ["CASES", "Case", "Compared", "compared"]

Floats = NDArray[np.float64]
Pictures = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Case:
    """Of a rig and its captures; stripes: of the display and of the sequence, 'unknown': 'rgb', unknown to
    the sequence; mix: standard deviation by which the stored mix is off, and says so; rest: heights are those
    against a capture of the mirror at rest."""

    lag: float = 0.0
    flicker: float = 0.0
    gamma: tuple[float, float, float] | None = None
    stripes: str = "none"
    mosaic: str | None = None
    mix: float = 0.0
    rest: bool = False


CASES: Mapping[str, Case] = {
    "nominal": Case(),
    "lag 10 %": Case(lag=0.1),
    "gamma 2.2": Case(gamma=(2.2, 2.2, 2.2)),
    "gamma 2.6/2.2/1.9": Case(gamma=(2.6, 2.2, 1.9)),
    "mix 1 % off": Case(mix=0.01),
    "flicker 2 %": Case(flicker=0.02),
    "stripes": Case(stripes="rgb"),
    "mosaic": Case(mosaic="RGGB"),
    "at rest": Case(rest=True),
    "stripes unknown, at rest": Case(stripes="unknown", rest=True),
}


class Compared(NamedTuple):
    """Exposures; height error (nm rms) and error over sigma of places and heights; share beyond 5 sigma;
    share of good pixels; named: notices."""

    exposures: int
    height_nm: float
    places: float
    heights: float
    beyond: float
    good: float
    named: bool


def compared(
    text: str, case: Case, seeds: int, size: tuple[int, int], colour: bool, rig: str = "prism48"
) -> Compared:
    """Root mean squares over captures of a preset's dent; shares are means."""
    runs = list(_runs(text, case, seeds, resize(load(rig, exact=True), *size), colour))
    every = np.array([run[1:6] for run in runs], np.float64)
    height, places, heights = np.sqrt(np.mean(np.square(every[:, :3]), axis=0)).tolist()
    beyond, good = every[:, 3:].mean(axis=0).tolist()
    named = any(run.named for run in runs)
    return Compared(runs[0].exposures, height, places, heights, beyond, good, named)


def _runs(text: str, case: Case, seeds: int, scene: Scene, colour: bool) -> Iterator[Compared]:
    stripes = {"none": None, "unknown": "rgb"}.get(case.stripes, case.stripes) if colour else None
    clean = replace(NOMINAL_SENSOR, gain_e=0.0, noise=0.0, bits=16, mosaic=case.mosaic if colour else None)
    display = None if case.gamma is None else Display(case.gamma[1], gammas=np.array(case.gamma))
    pattern = replace(scene.pattern, stripes=stripes)
    scene = replace(scene, sensor=clean, display=display, pattern=pattern)
    surface, flat = (dent_from_text(dent or "flat", scene) for dent in (scene.dent, "flat"))
    shown = sequence_from_text(text, scene.pattern.rows, scene.pattern.cols)
    shown = packed(shown, case.stripes) if colour else shown

    def light(surface: Surface) -> Pictures:
        if colour:
            return capture_colour(scene, surface, shown).images
        return capture(scene, surface, shown).frames

    def taken(light: Pictures, rng: np.random.Generator) -> Correspondence:
        images = _levels(light, case, rng)
        frames = _unmixed(images, shown, case, rng) if colour else Capture(images, shown)
        return decode(frames.frames, frames.sequence)

    pressed, rest = light(surface), light(flat) if case.rest else None
    truth, common = trace(scene, surface), _common(case, colour)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        found = taken(pressed, rng)
        ratios = []
        for axis, off in zip("uv", (common, 0.0), strict=True):
            error = getattr(found, axis) - getattr(truth, axis) - off
            ratios.append((error / getattr(found, f"sigma_{axis}"))[found.good])
        places = np.concatenate(ratios)
        heights = reconstruct(found, scene, rest=None if rest is None else taken(rest, rng))
        rig = 0.0 if heights.calibration_sigma is None else heights.calibration_sigma
        error, own = (heights.z - truth.z)[heights.good], np.hypot(heights.sigma, rig)[heights.good]
        yield Compared(
            shown.exposures,
            1e6 * float(np.sqrt(np.mean(error**2))),
            float(np.sqrt(np.median(places**2) / 0.4549)),
            float(np.sqrt(np.mean((error / own) ** 2))),
            float(np.mean(np.abs(places) > 5)),
            float(found.good.mean()),
            bool(found.notices),
        )


def _common(case: Case, colour: bool) -> float:
    """Cells by which all u are off: red lies aside, and the sequence does not know it."""
    return -STRIPES["rgb"][0] if colour and case.stripes == "unknown" else 0.0


def _levels(light: Pictures, case: Case, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Pictures of 8 bits with photon and read noise."""
    level = light / np.iinfo(light.dtype).max * 255 - NOMINAL_SENSOR.offset
    level[1:] = (1 - case.lag) * level[1:] + case.lag * level[:-1]
    swing = 1 + case.flicker * np.sin(2 * np.pi * rng.random(len(level)))
    level = level * swing.reshape(-1, *(1,) * (level.ndim - 1))
    level = (
        rng.poisson(np.maximum(level, 0) * NOMINAL_SENSOR.gain_e) / NOMINAL_SENSOR.gain_e
        + NOMINAL_SENSOR.offset
    )
    return np.clip(np.rint(level + NOMINAL_SENSOR.noise * rng.standard_normal(level.shape)), 0, 255).astype(
        np.uint8
    )


def _unmixed(images: NDArray[np.uint8], shown: Sequence, case: Case, rng: np.random.Generator) -> Capture:
    """By the sensor's mix, off by the case's error."""
    exact = exact_response(replace(NOMINAL_SENSOR, mosaic=case.mosaic))
    off = case.mix * NOMINAL_SENSOR.exposure
    mix = exact.mix + off * rng.standard_normal((3, 3))
    return ColourCapture(images, shown).unmixed(replace(exact, mix=mix, mix_sigma=np.full((3, 3), off)))
