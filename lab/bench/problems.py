"""Exact correspondences of difficult mirrors, noisy, holed, spoiled: problems of the solver."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from optolever.decode import Correspondence, Flag
from optolever.experiments.arrays import Floats, Mask
from optolever.experiments.place import EXACT_SIGMA, Dent, Place, surface_of
from optolever.scene import Scene, Surface, Trace

#: (truth, random numbers) -> lost pixels; or (u, v) changed in place
Hide = Callable[[Trace, Scene, np.random.Generator], Mask]


@dataclass(frozen=True, slots=True)
class Problem:
    """A mirror, what of it is not seen (flagged by the decoder), and how many pixels are wrong unflagged."""

    name: str
    dent: Dent
    scene: str = "paper-simulation"
    hide: Hide | None = None
    outliers: float = 0.0


def _step(scene: Scene, pixels: float, depth: float = 1.0, radial: bool = False) -> Surface:
    """Smooth steps, `depth` times the default peak, `pixels` camera pixels wide: both sides of a trench
    across the mirror, or the rim of a disk.
    """
    length, middle = scene.mirror.length, scene.mirror.width / 2
    peak, width = depth * 1.3 / 163.7 * length, pixels * length / scene.camera.cols

    def inward(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """How far inside the step, and the gradient of that."""
        if not radial:
            return 0.2 * length - np.abs(x - 0.4 * length), -np.sign(x - 0.4 * length), np.zeros_like(x)
        distance = np.hypot(x - length / 2, y - middle)
        safe = np.maximum(distance, 1e-12 * length)
        return 0.2 * length - distance, -(x - length / 2) / safe, -(y - middle) / safe

    def form(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        depth, by_x, by_y = inward(x, y)
        slope = 0.5 * peak / width / np.cosh(np.clip(depth / width, -300, 300)) ** 2
        return np.asarray(0.5 * peak * (1 + np.tanh(depth / width))), slope * by_x, slope * by_y

    return surface_of(form)


def _disks(truth: Trace, scene: Scene, rng: np.random.Generator) -> Mask:
    """Round holes of 3 to 10 % of the image."""
    rows, cols = truth.u.shape
    y, x = np.mgrid[:rows, :cols]
    lost = np.zeros((rows, cols), np.bool_)
    for _ in range(6):
        row, col, radius = rng.uniform((0, 0, 0.03 * rows), (rows, cols, 0.1 * rows))
        lost |= (y - row) ** 2 + (x - col) ** 2 < radius**2
    return lost


def _slits(truth: Trace, scene: Scene, rng: np.random.Generator) -> Mask:
    """Slits of one pixel that leave a tenth of the image open at one end."""
    rows, cols = truth.u.shape
    lost = np.zeros((rows, cols), np.bool_)
    lost[rows // 3, : -cols // 10] = True
    lost[rows // 10 :, cols // 2] = True
    return lost


def _cut(truth: Trace, scene: Scene, rng: np.random.Generator) -> Mask:
    """A closed ring: what it encloses is an island."""
    rows, cols = truth.u.shape
    y, x = np.mgrid[:rows, :cols]
    distance = np.hypot(y - rows / 2, x - cols / 2)
    return np.asarray(np.abs(distance - 0.25 * rows) < 1.5)


def _dropouts(truth: Trace, scene: Scene, rng: np.random.Generator) -> Mask:
    """One pixel in five."""
    return np.asarray(rng.random(truth.u.shape) < 0.2)


def _half(truth: Trace, scene: Scene, rng: np.random.Generator) -> Mask:
    """More than half of all pixels: what is left percolates barely."""
    return np.asarray(rng.random(truth.u.shape) < 0.38)


def _dark(truth: Trace, scene: Scene, rng: np.random.Generator) -> Mask:
    """Where total reflection is lost and less than half of the light comes back."""
    assert scene.medium is not None
    with np.errstate(invalid="ignore"):
        return np.asarray(~(scene.medium.reflectance(np.cos(truth.incidence)) >= 0.5))


PROBLEMS = (
    Problem("smooth", "raised-cosine"),
    Problem("cusp", "needle"),
    Problem("rounded needle, steep ring off the pattern", "rounded-needle:peak=10,rounding=4"),
    Problem("ridge", "ridge"),
    Problem("sharp ridge, askew", "ridge:sigma=4,angle_deg=30"),
    Problem("step, measurable", partial(_step, pixels=6)),
    Problem("step, one pixel wide", partial(_step, pixels=1)),
    Problem("step, off the pattern", partial(_step, pixels=3, depth=6)),
    Problem("plateau, measurable", partial(_step, pixels=6, radial=True)),
    Problem("plateau, one pixel wide", partial(_step, pixels=1, radial=True)),
    Problem("plateau, ring off the pattern", partial(_step, pixels=3, depth=6, radial=True)),
    Problem("folded map", "gaussian:peak=2,sigma=9"),
    Problem("ball", "ball"),
    Problem("total reflection lost", "gaussian:peak=0.6,sigma=6", "prism48", _dark),
    Problem("pinhole", "", "monitor-mirror"),
    Problem("pinhole, holes", "", "monitor-mirror", _disks),
    Problem("holes", "raised-cosine", hide=_disks),
    Problem("slits", "raised-cosine", hide=_slits),
    Problem("island", "raised-cosine", hide=_cut),
    Problem("dropouts 20 %", "raised-cosine", hide=_dropouts),
    Problem("dropouts 38 %", "gaussian", hide=_half),
    Problem("outliers 1 %", "raised-cosine", outliers=0.01),
    Problem("outliers 5 %, holes", "gaussian", hide=_disks, outliers=0.05),
)


def spoiled(problem: Problem, place: Place, noise: float, dtype: str) -> Correspondence:
    """The true correspondence with noise (px), lost pixels flagged, outliers not."""
    rng, truth = np.random.default_rng(11), place.truth
    shape = truth.u.shape
    u, v = (part + noise * rng.standard_normal(shape) for part in (truth.u, truth.v))
    lost = ~truth.visible
    if problem.hide is not None:
        lost |= problem.hide(truth, place.scene, rng)
    if problem.outliers:
        wrong = rng.random(shape) < problem.outliers
        u[wrong] += rng.normal(0.0, 20.0, int(wrong.sum()))
    sigma = np.full(shape, max(noise, EXACT_SIGMA))
    flags = np.where(lost, int(Flag.INVALID), 0).astype(np.uint16)
    kind: Any = np.dtype(dtype)
    return Correspondence(u.astype(kind), v.astype(kind), sigma.astype(kind), sigma.astype(kind), flags)
