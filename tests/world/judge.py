"""A shot decoded and compared with its truth: places, heights, notices; the cases of limits.toml."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_cdt

from optolever.decode import Correspondence, decode
from optolever.errors import InputError
from optolever.reconstruct import reconstruct

from .light import Shot, World, shoot
from .rigs import F64, Rig, draw_rig

SIGMAS = 5.0
LIMITS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("limits.toml").read_text(encoding="utf-8"))


def cases() -> Iterator[tuple[str, list[str], dict[str, Any]]]:
    """Name, codes and fields of World of every effect."""
    yield "clean", list(LIMITS["clean"]["codes"]), {}
    for group in ("reflectance", "faults", "order", "measured"):
        for name, world in LIMITS[group]["effects"].items():
            yield name, LIMITS[group]["codes"], world


@dataclass(frozen=True)
class Verdict:
    """good: share of the lit pixels; places, heights: share of the good ones beyond 5 sigma, and rms(error /
    sigma); silent: share of the lit pixels whose height is good and beyond 5 sigma (places without heights);
    told: notices of the decoder.
    """

    rig: str
    code: str
    good: float
    places: float
    place_ratio: float
    heights: float
    height_ratio: float
    told: tuple[str, ...]

    @property
    def silent(self) -> float:
        return self.good * float(np.nan_to_num(self.heights if np.isfinite(self.heights) else self.places))


def run(number: int, code: str, world: World, seed: int = 0) -> Verdict:
    """One capture of a rig, from its frames to heights."""
    rig = draw_rig(number, world.critical)
    shot = shoot(rig, code, world, seed)
    lens = world.lens if world.told else None
    return judged(rig, code, shot, decode(shot.frames, shot.sequence, lens_px=lens))


def judged(rig: Rig, code: str, shot: Shot, found: Correspondence) -> Verdict:
    """Beside its truth."""
    use, axes = found.good & shot.lit, ((found.u, found.sigma_u, "u"), (found.v, found.sigma_v, "v"))
    score = np.stack([(place - shot.truth[name])[use] / sigma[use] for place, sigma, name in axes])
    heights = _height_scores(rig, shot, found)
    names = tuple(dict.fromkeys(str(one.name) for one in found.notices))
    good = float(found.good[shot.lit].mean())
    return Verdict(rig.name, code, good, *_figures(score), *_figures(heights[None]), names)


def _figures(score: F64) -> tuple[float, float]:
    """Share beyond SIGMAS on any axis of (axes, n), and rms; NaN of none."""
    if not score.size:
        return float("nan"), float("nan")
    beyond = ~(np.abs(score) <= SIGMAS)
    return float(beyond.any(axis=0).mean()), float(np.sqrt(np.mean(np.square(score))))


def _height_scores(rig: Rig, shot: Shot, found: Correspondence) -> F64:
    """Errors over sigma (n,) of the heights, anchored at the true point farthest from any pixel refused."""
    truth, use = shot.truth, found.good & shot.lit
    if use.sum() < 100:
        return np.empty(0)
    inside = distance_transform_cdt(np.pad(use, 1))[1:-1, 1:-1]
    at = np.unravel_index(int(inside.argmax()), inside.shape)
    anchor = (float(truth["x"][at]), float(truth["y"][at]), float(truth["z"][at]))
    try:
        height = reconstruct(found, rig.scene, anchor=anchor)
    except InputError:
        return np.empty(0)
    good = (height.flags == 0) & np.isfinite(truth["z"])
    return np.asarray(((height.z - truth["z"]) / height.sigma)[good], np.float64)
