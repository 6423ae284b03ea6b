"""The tables of Saga, Kajimoto, Tachi, "High-Resolution Tactile Sensor Using the Movement of a Reflected
Image".

A cut through the prism: l from the pattern's edge along the mirror, d into the prism, m and w the places of
a ray on the pattern and on the capture face, alpha and beta its angles with the mirror's normal, theta =
atan(dd/dl). Numbers in brackets are the paper's equations. `sign` +1 is the reflection law, alpha = beta + 2
theta; -1 is the sign in print. `gamma`: kept in (12), or set to 0 as in (16).

    python examples/paper/tables.py [--pixels N] [--seed N]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.reconstruct import exact_correspondence, reconstruct
from optolever.scene import Scene, Surface, dent_from_text, load, resize, trace

Array = NDArray[np.float64]
HALVINGS, SERIES_BELOW = 60, 1e-4
#: Case: scene, dent, lines of the lattice.
CASES = {
    "smooth": ("paper-simulation", "raised-cosine", 64),
    "needle": ("paper-simulation", "needle", 64),
    "pencil": ("paper-prototype", "", 16),
}


@dataclass(frozen=True)
class Prism:
    """Angles of both faces with the mirror (rad), and the mirror's length (mm); the camera is at infinity."""

    alpha0: float
    beta0: float
    length: float

    @classmethod
    def of(cls, scene: Scene) -> Prism:
        pattern, camera = scene.pattern.u_axis, scene.camera.u_axis
        return cls(np.arctan2(pattern[2], pattern[0]), np.arctan2(camera[2], -camera[0]), scene.mirror.length)

    def pattern_place(self, l: Array, d: Array, theta: Array, sign: int) -> Array:
        """m of the ray that the mirror sends to the pattern: (9), (12)."""
        alpha = self.beta0 + 2 * sign * theta
        return np.asarray(np.hypot(l, d) * np.cos(alpha - np.arctan2(d, l)) / np.cos(alpha - self.alpha0))

    def capture_place(self, l: Array, d: Array) -> Array:
        """w of the ray from the mirror to a camera at infinity: (14)."""
        return np.asarray((self.length - l) * np.cos(self.beta0) + d * np.sin(self.beta0))

    def mirror_place(self, w: Array, d: Array) -> Array:
        """l on the ray of w at depth d: (14) solved for l."""
        return np.asarray(self.length - (w - d * np.sin(self.beta0)) / np.cos(self.beta0))

    def slope(self, l: Array, d: Array, m: Array, sign: int, gamma: bool) -> Array:
        """Theta from the pattern's place: (16) to second order, (17) re-derived, (9)."""
        a = self.alpha0 - np.arctan2(d, l) * gamma
        square = l**2 + d**2
        linear = square * np.sin(a) * np.cos(a)
        constant = m**2 - square * np.cos(a) ** 2
        root = np.sqrt(np.maximum(linear**2 - (square * np.cos(2 * a) - m**2) * constant, 0.0))
        alpha = self.alpha0 - constant / (linear + np.copysign(root, linear))
        return np.asarray(sign * (alpha - self.beta0) / 2)


def rise(step: Array, theta: Array, change: Array) -> Array:
    """Rise over a step with a linear change of the slope angle: (5), (19); its series where that is 0."""
    small, middle = np.abs(change) < SERIES_BELOW, np.tan(theta + change / 2)
    safe = np.where(small, 1.0, change)
    closed = np.log(np.abs(np.cos(theta) / np.cos(theta + safe))) / safe
    return np.asarray(step * np.where(small, middle * (1 + change**2 / 12 * (1 + middle**2)), closed))


def march(prism: Prism, m: Array, w: Array, sign: int = 1, gamma: bool = True) -> Array:
    """Depth (..., points) along the last axis, from d = 0 at the first point: (18), (14), (17), (19).

    Each point takes the rise of the step before. Points without data (NaN) keep NaN and are stepped over.
    """
    depth = np.full(m.shape, np.nan)
    d, climb, place, theta = (np.zeros(m.shape[:-1]) for _ in range(4))
    begun, first = np.zeros(m.shape[:-1], bool), prism.mirror_place(w[..., 1], 0.0 * w[..., 1])
    first = first - prism.mirror_place(w[..., 0], 0.0 * w[..., 0])
    for n in range(m.shape[-1]):
        here = prism.mirror_place(w[..., n], d + climb)
        angle = prism.slope(here, d + climb, m[..., n], sign, gamma)
        valid = np.isfinite(angle)
        depth[..., n] = np.where(valid, d + climb, np.nan)
        d = np.where(valid, d + climb, d)
        step = np.where(begun, rise(here - place, theta, angle - theta), first * np.tan(angle))
        climb = np.where(valid, step, climb)
        place, theta = np.where(valid, here, place), np.where(valid, angle, theta)
        begun |= valid
    return depth


def depths(prism: Prism, m: Array, w: Array, sign: int = 1, gamma: bool = True) -> dict[str, Array]:
    """Drops (from l = L0), rises (from l = 0) and their mean, of points by rising l."""
    drops = march(prism, m[..., ::-1], w[..., ::-1], sign, gamma)[..., ::-1]
    rises = march(prism, m, w, sign, gamma)
    return {"drops": drops, "rises": rises, "mean": (drops + rises) / 2}


def inverse(rising: Callable[[Array], Array], values: Array, length: float) -> Array:
    """The arguments in (0, length) of a rising function, by bisection."""
    low, high = np.zeros_like(values), np.full_like(values, length)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        below = rising(middle) < values
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray((low + high) / 2)


@dataclass(frozen=True)
class Cut:
    """The cut through the dent's middle."""

    prism: Prism
    surface: Surface
    y: float

    def places(self, l: Array, sign: int) -> tuple[Array, Array, Array]:
        """m, w and true d of mirror points."""
        y = np.full_like(l, self.y)
        d = np.asarray(self.surface.height(l, y), np.float64)
        theta = np.arctan(np.asarray(self.surface.gradient(l, y)[0], np.float64))
        return self.prism.pattern_place(l, d, theta, sign), self.prism.capture_place(l, d), d

    def lattice(self, lines: int, sign: int) -> tuple[Array, Array, Array]:
        """m, w and true d of equally spaced lines on the pattern; lines that a cusp hides are left out."""
        prism = self.prism
        face = prism.length * np.cos(prism.beta0) / np.cos(prism.beta0 - prism.alpha0)
        m = face * (np.arange(lines) + 0.5) / lines
        l = inverse(lambda x: self.places(x, sign)[0], m, prism.length)
        return self.places(l[np.abs(self.places(l, sign)[0] - m) < 1e-6 * face], sign)


@dataclass(frozen=True)
class Row:
    """Rms errors over the peak depth along the cut; field: of all pixels, by drops or the dense solver."""

    case: str
    data: str
    law: str
    method: str
    errors: dict[str, float]
    field: float | None = None

    def __str__(self) -> str:
        cells = [f"{100 * self.errors[name]:.3g}" if name in self.errors else "" for name in NAMES]
        whole = "" if self.field is None else f"{100 * self.field:.3g}"
        line = f"{self.case:7} {self.data:7} {self.law:11} {self.method:40}"
        return (line + "".join(f"{cell:>9}" for cell in [*cells, whole])).rstrip()


NAMES = ("drops", "rises", "mean")


def relative(depth: Array, truth: Array, peak: float) -> float:
    """Rms error over the peak, of points with a depth."""
    return float(np.sqrt(np.nanmean((depth - truth) ** 2))) / peak


def equations(sign: int, gamma: bool) -> str:
    return f"{'reflection' if sign == 1 else 'printed'} sign, gamma {'kept' if gamma else '0'}"


def simulated(case: str, cut: Cut, lines: int, peak: float) -> Iterator[Row]:
    """The paper's own simulation: lattice points, light by the reflection law and by the print."""
    for law, forward in (("reflection", 1), ("print", -1)):
        m, w, truth = cut.lattice(lines, forward)
        for sign in (1, -1):
            for gamma in (False, True):
                found = depths(cut.prism, m, w, sign, gamma)
                errors = {name: relative(depth, truth, peak) for name, depth in found.items()}
                yield Row(case, "exact", law, f"lattice, {equations(sign, gamma)}", errors)


def measured(
    case: str, scene: Scene, surface: Surface, seen: Correspondence, data: str, peak: float
) -> Iterator[Row]:
    """Every pixel of every camera row, by the paper's recursion and by the dense solver."""
    prism, truth, row = Prism.of(scene), trace(scene, surface), scene.camera.rows // 2
    origins = scene.camera.rays_at(
        np.zeros(scene.camera.cols), np.arange(scene.camera.cols, dtype=np.float64)
    )[0]
    along = np.array([-np.cos(prism.beta0), 0.0, np.sin(prism.beta0)])
    w = np.broadcast_to((origins - [prism.length, 0.0, 0.0]) @ along, seen.u.shape)[:, ::-1]
    start = float(scene.pattern.origin @ scene.pattern.u_axis)
    m = np.where(seen.good, start + np.asarray(seen.u, np.float64) * scene.pattern.pitch, np.nan)[:, ::-1]
    z = np.where(truth.visible, truth.z, np.nan)
    found = {name: depth[:, ::-1] for name, depth in depths(prism, m, w).items()}
    errors = {name: relative(depth[row], z[row], peak) for name, depth in found.items()}
    yield Row(
        case, data, "reflection", f"pixels, {equations(1, True)}", errors, relative(found["drops"], z, peak)
    )
    dense = reconstruct(seen, scene)
    height = np.where(dense.good, dense.z, np.nan)
    errors = {"mean": relative(height[row], z[row], peak)}
    yield Row(case, data, "reflection", "pixels, dense solver", errors, relative(height, z, peak))


def tables(pixels: int = 400, seed: int = 0, noise: float = 1.0, renderer: str = "auto") -> Iterator[Row]:
    """The rows of all cases, on cameras of pixels x pixels."""
    for case, (name, dent, lines) in CASES.items():
        scene = resize(load(name, exact=True), pixels, pixels)
        surface = dent_from_text(dent or scene.dent or "", scene)
        cut = Cut(Prism.of(scene), surface, scene.mirror.width / 2)
        l = np.linspace(0.0, scene.mirror.length, 4001)
        peak = float(np.max(cut.places(l, 1)[2]))
        yield from simulated(case, cut, lines, peak)
        yield from measured(
            case, scene, surface, exact_correspondence(trace(scene, surface), 0.01), "exact", peak
        )
        shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
        taken = capture(scene, surface, shown, noise=noise, seed=seed, renderer=renderer)
        yield from measured(case, scene, surface, decode(taken.frames, shown), "frames", peak)


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Errors in % of the peak depth, along the cut and of all pixels."
    )
    parser.add_argument("--pixels", type=int, default=400, help="rows and columns of the camera")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise in the frames")
    given = parser.parse_args()
    print(
        f"{'case':7} {'data':7} {'light':11} {'method':40}"
        + "".join(f"{name:>9}" for name in (*NAMES, "field"))
    )
    for row in tables(given.pixels, given.seed):
        print(row, flush=True)


if __name__ == "__main__":
    main()
