"""What a calibration is worth, by simulation: `python -m lab calibration`.

Truth is traced by the scene, never by the adjustment's model. An error of calibration moves a
whole height map at once, so that a map is one sample: chi2/r of the r coefficients of its modes.
The truth is moved to the frame in which the gauge leaves the heights (`rigs.frame_change`).
Modes are counted from a tenth of the mirror's length on: at the edge that it shares with a prism's pattern,
single pixels have no derivative, and one of them would be the leading mode.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.calibration import calibrate, default_priors
from optolever.errors import InputError
from optolever.reconstruct import HeightMap, PixelAnchor, reconstruct
from optolever.records import LOG
from optolever.scene import Covariance, Scene, Surface, trace

from .rigs import Capturer, Rig, correspondence_of, frame_change, open_air, prism

__all__ = ["SETUPS", "Figure", "figures", "mode_chi2"]


_EDGE = 0.1  # of the mirror's length: where noise figures hold from (reconstruct's)
_SHARE = 0.999  # of the modes' variance: how many are counted
_COLUMNS = {"air": 100, "balls": 200, "rest": 100}  # a ball's contact must hold enough pixels
_FLATNESS = 1e-3  # mm, of the reference: `Flat`'s own
_NOISE = {"air": 0.0016, "prism": 0.005}  # of the thinned pattern's cells: 0.02 of the display's

#: Name -> (kind, captures, pinhole); places are those of random streams: a new one stands last.
SETUPS = {
    **{f"air K = {k}": ("air", k, False) for k in (3, 5, 8)},
    "pinhole, rest + 3 balls": ("prism", 3, True),
    "prism, priors alone": ("typed", 0, False),
    "prism, rest": ("prism", 0, False),
    "prism, rest + 3 balls": ("prism", 3, False),
    "pinhole, k1 0.08, rest + 3 balls": ("lens", 3, True),
    "prism, rest + 2 balls": ("prism", 2, False),
}


@dataclass(frozen=True, slots=True)
class Figure:
    """One draw. error: rms of dent less rest over the dent's depth; scale, sigma_scale: relative error of its
    depth, and what the modes predict; chi: of the adjustment; chi2: of the r = modes coefficients, per mode;
    absolute, change: rms of error over total sigma, of heights and of dent less rest; seconds of processor
    time that the calibration took."""

    setup: str
    seed: int
    error: float
    scale: float
    chi: float
    chi2: float
    modes: int
    sigma_scale: float
    absolute: float
    change: float
    seconds: float


def mode_chi2(error: Floats, modes: NDArray[np.floating[Any]]) -> tuple[float, int]:
    """chi2 per mode of an error map's (n,) coefficients on the r leading principal modes that hold 99.9 % of
    the modes' (k, n) variance; and r. The map's noise is not taken off: its sigma, which holds contradictions
    of the scene as well, would take off what is judged."""
    _, sizes, right = np.linalg.svd(modes.astype(np.float64), full_matrices=False)
    held = np.cumsum(sizes**2) / (sizes**2).sum()
    count = int(np.searchsorted(held, _SHARE)) + 1
    coefficients = right[:count] @ error / sizes[:count]
    return float(np.mean(coefficients**2)), count


def figures(setup: str, seeds: range) -> Iterator[Figure]:
    """One draw per seed: a rig with its own errors, captures, calibration, and a dent measured with it; none
    where no height is left unflagged, or the captures are refused."""
    for seed in seeds:
        try:
            figure = _figure(setup, seed)
        except InputError as error:
            LOG.warning("%s, seed %d: %s", setup, seed, error)
            continue
        if figure is not None:
            yield figure


def _figure(setup: str, seed: int) -> Figure | None:
    kind, count, pinhole = SETUPS[setup]
    rng = np.random.default_rng([seed, list(SETUPS).index(setup)])
    take = correspondence_of(_NOISE["air" if kind == "air" else "prism"], rng)
    size = _COLUMNS["air" if kind == "air" else "balls" if count else "rest"]
    if kind == "air":
        rig = open_air(rng, count, take, size=size, flatness=_FLATNESS)
    else:
        rig = prism(rng, count, take, pinhole, size, kind == "lens")
    started, chi, start = time.process_time(), 1.0, rig.given
    if kind == "typed":  # nothing is calibrated: the default priors are the covariance
        priors = default_priors(start)
        scene = replace(start, covariance=Covariance(tuple(priors), np.diag(np.square([*priors.values()]))))
    else:
        found = calibrate(rig.given, rig.observations)
        scene, start, chi = found.scene, found.start, found.adjustment.chi
    seconds = time.process_time() - started
    take = correspondence_of(1e-4, rng)  # what noise does to the measured map is reconstruct's to tell
    frame = frame_change(rig, start)
    (height, z), (rest, z0) = (
        _measured(rig, scene, frame, surface, take, 100 + k) for k, surface in enumerate((rig.dent, rig.rest))
    )
    good = height.good & rest.good & np.isfinite(z) & np.isfinite(z0)
    if not good.any():
        return None
    assert height.calibration is not None
    assert rest.calibration is not None
    change, true = (height.z - rest.z)[good], (z - z0)[good]
    error, weight = change - true, true / (true @ true)
    spread = height.difference(rest)[1][good]
    far = good & (height.x >= _EDGE * start.mirror.length)
    chi2, modes = mode_chi2((height.z - z)[far], height.calibration[:, far])
    return Figure(
        setup,
        seed,
        error=_rms(error) / true.max(),
        scale=float(error @ weight),
        chi=chi,
        chi2=chi2,
        modes=modes,
        sigma_scale=float(np.linalg.norm((height.calibration - rest.calibration)[:, good] @ weight)),
        absolute=_rms((height.z - z)[good] / height.total_sigma[good]),
        change=_rms(error / spread),
        seconds=seconds,
    )


def _rms(values: NDArray[np.floating[Any]]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _measured(
    rig: Rig, scene: Scene, frame: tuple[Floats, Floats], surface: Surface, take: Capturer, index: int
) -> tuple[HeightMap, Floats]:
    """Height by the calibrated scene, anchored at a pixel where it is known, and the truth in its frame."""
    seen, (rotation, shift) = trace(rig.truth, surface), frame
    z = np.stack([seen.x, seen.y, seen.z], axis=-1) @ rotation[2] + shift[2]
    row, cols = z.shape[0] // 2, z.shape[1]
    known = np.flatnonzero(np.isfinite(z[row, cols // 10 :])) + cols // 10
    anchor = PixelAnchor(row, int(known[0]), float(z[row, known[0]]))
    height = reconstruct(take(rig.truth, surface, index), scene, anchor=anchor)
    return height, z
