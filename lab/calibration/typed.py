"""Rigs that are not as typed: one kind of error drawn from the priors, heights against their total sigma.

Rest and press are traced through the rig as it is (`scene.trace`; a cover glass by vector refraction, which
the reconstruction does not use) and reconstructed with the scene as it was typed, alone and against the rest
capture.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import nan

import numpy as np

from optolever import InputError
from optolever.arrays import Floats
from optolever.decode import Correspondence
from optolever.reconstruct import PixelAnchor, reconstruct
from optolever.scene import (
    TYPED,
    Scene,
    Surface,
    TelecentricCamera,
    Trace,
    adjusted,
    load,
    parameter_values,
    resize,
    trace,
    typed_sigmas,
)

from .rigs import behind_face, dented, form, shape_surface

__all__ = ["KINDS", "TypedRun", "typed_runs"]

Rng = np.random.Generator

_NOISE = 0.01  # px
_GLASS = 1.5  # index
_SIZE = (120, 160)
_SILENT = 0.01  # share of the heights


@dataclass(frozen=True, slots=True)
class _Drawn:
    """A rig as it is: numbers, and glass, stripes, sag and motion, in standard deviations of typed ones."""

    numbers: dict[str, float]
    glass: float = 0.0
    stripes: float = 0.0
    sag: tuple[float, float, float] = (0.0, 0.0, 0.0)
    motion: float = 0.0


@dataclass(frozen=True, slots=True)
class TypedRun:
    """One capture. Of its good heights: medians of error and total sigma (mm), rms of error over total sigma,
    share beyond five total sigma; limits: of its tests; named: the ones that fail; refused: no height is
    trusted."""

    kind: str
    scene: str
    seed: int
    rest: bool
    good: float
    error: float
    sigma: float
    ratio: float
    beyond: float
    limits: dict[str, float]
    named: tuple[str, ...]
    refused: bool

    @property
    def silent(self) -> bool:
        """More than 1 % of the heights beyond five total sigma, without a notice."""
        return self.beyond > _SILENT and not self.named


def _numbers(*keys: str) -> Callable[[Scene, Rng], _Drawn]:
    def draw(scene: Scene, rng: Rng) -> _Drawn:
        names = [name for name in typed_sigmas(scene) if any(name.startswith(key) for key in keys)]
        return _Drawn({name: float(rng.standard_normal()) for name in names})

    return draw


def _all(scene: Scene, rng: Rng) -> _Drawn:
    numbers = _numbers("camera", "pattern", "face")(scene, rng).numbers
    glass, stripes, motion, *sag = rng.standard_normal(6)
    return _Drawn(numbers, abs(glass), stripes, tuple(sag), motion)


_POSES = ("x", "y", "z", "rx", "ry", "rz")
#: Kind of error -> draws it.
KINDS: dict[str, Callable[[Scene, Rng], _Drawn]] = {
    "camera pose": _numbers(*(f"camera.{name}" for name in _POSES)),
    "pattern pose": _numbers(*(f"pattern.{name}" for name in _POSES)),
    "both poses": _numbers(*(f"{part}.{name}" for part in ("camera", "pattern") for name in _POSES)),
    "camera scale": _numbers("camera.f", "camera.pitch"),
    "pattern pitch": _numbers("pattern.pitch"),
    "bow": _numbers("pattern.b"),
    "glass": lambda scene, rng: _Drawn({}, glass=abs(rng.standard_normal())),
    "stripes": lambda scene, rng: _Drawn({}, stripes=rng.standard_normal()),
    "face, index": _numbers("face"),
    "lens": _numbers("camera.k1", "camera.cx", "camera.cy"),
    "motion, sag": lambda scene, rng: _Drawn(
        {}, sag=tuple(rng.standard_normal(3)), motion=rng.choice((-1.0, 1.0))
    ),
    "all": _all,
}


def typed_runs(kinds: tuple[str, ...], seeds: range, times: float = 1.0) -> Iterator[TypedRun]:
    """Runs of every kind and seed, alone and against rest; times: of the priors."""
    scenes = (
        resize(load("prism48"), *_SIZE),
        replace(behind_face(_SIZE[1]), accuracy=TYPED),
        resize(load("monitor-mirror"), *_SIZE),
    )
    for kind in kinds:
        for seed in seeds:
            rng = np.random.default_rng([seed, list(KINDS).index(kind)])
            able = [scene for scene in scenes if _has(kind, scene)]
            scene = able[seed % len(able)]
            yield from _runs(kind, scene, seed, rng, times)


def _has(kind: str, scene: Scene) -> bool:
    """Whether the scene can have such an error."""
    drawn = KINDS[kind](scene, np.random.default_rng(0))
    return bool(drawn.numbers or drawn.glass or drawn.stripes or drawn.motion)


def _runs(kind: str, typed: Scene, seed: int, rng: Rng, times: float) -> Iterator[TypedRun]:
    drawn = KINDS[kind](typed, rng)
    own, sigmas = parameter_values(typed), typed_sigmas(typed)
    true = adjusted(
        typed, {name: own[name] + times * sigmas[name] * off for name, off in drawn.numbers.items()}
    )
    rest, press = _surfaces(typed, times * 0.01 / np.sqrt(3) * np.array(drawn.sag), rng)
    seen = {}
    for name, surface, rig in (("rest", rest, true), ("press", press, moved(true, drawn.motion, rng))):
        seen[name] = _captured(rig, surface, times * drawn.glass, times * 0.05 * drawn.stripes, rng)
    (flat, at_rest), (truth, pressed) = seen["rest"], seen["press"]
    for against in (False, True):
        z = truth.z - flat.z if against else truth.z
        rest_capture = at_rest if against else None
        try:
            height = reconstruct(pressed, typed, anchor=_anchor(typed, z), rest=rest_capture)
        except InputError:  # an anchor that the camera does not see
            yield TypedRun(kind, typed.name, seed, against, 0.0, nan, nan, nan, 0.0, {}, ("refused",), True)
            continue
        good = height.good & np.isfinite(z)
        if not good.any():
            named = tuple(test.test for test in height.tests if test.fails)
            yield TypedRun(kind, typed.name, seed, against, 0.0, nan, nan, nan, 0.0, {}, named, True)
            continue
        error, sigma = np.abs(height.z - z)[good], height.total_sigma[good]
        share = error / sigma
        yield TypedRun(
            kind,
            typed.name,
            seed,
            against,
            good=float(good.mean()),
            error=float(np.median(error)),
            sigma=float(np.median(sigma)),
            ratio=float(np.sqrt(np.mean(share**2))),
            beyond=float(np.mean(share > 5)),
            limits={test.test: test.limit for test in height.tests},
            named=tuple(test.test for test in height.tests if test.fails),
            refused=height.implausible,
        )


def _surfaces(scene: Scene, sag: Floats, rng: Rng) -> tuple[Surface, Surface]:
    """The mirror at rest, and with a dent somewhere beside its middle."""
    length, width = scene.mirror.length, scene.mirror.width
    depth = length / rng.uniform(200, 1000)
    size = length * rng.uniform(0.06, 0.12)
    x, y = length * rng.uniform(0.35, 0.65), width * rng.uniform(0.35, 0.65)
    bent = form(sag, scene.mirror)
    return shape_surface(bent), dented(bent, x, y, depth, size)


def moved(scene: Scene, motion: float, rng: Rng) -> Scene:
    """The rig moved between two captures: 1 um and 5 arcsec per number, times `motion`."""
    if not motion:
        return scene
    own, values = parameter_values(scene), {}
    for part in ("camera", "pattern"):
        for name in _POSES:
            size = np.radians(5 / 3600) if name.startswith("r") else 1e-3
            values[f"{part}.{name}"] = own[f"{part}.{name}"] + motion * size * rng.standard_normal()
    return adjusted(scene, values)


def _captured(
    scene: Scene, surface: Surface, glass: float, stripes: float, rng: Rng
) -> tuple[Trace, Correspondence]:
    truth = trace(scene, surface)
    du, dv = behind_glass(scene, truth, glass)
    u, v = (at + _NOISE * rng.standard_normal(at.shape) for at in (truth.u + du + stripes, truth.v + dv))
    sigma = np.full(u.shape, _NOISE)
    return truth, Correspondence(u, v, sigma, sigma.copy(), np.where(truth.visible, 0, 1).astype(np.uint16))


def behind_glass(scene: Scene, truth: Trace, thickness: float) -> tuple[Floats, Floats]:
    """Change of u and v by a plate of glass before the cells: the ray is refracted as a vector (Snell's law)
    and followed through the plate."""
    if not thickness:
        return np.zeros(truth.u.shape), np.zeros(truth.u.shape)
    pattern = scene.pattern
    points = np.stack([truth.x, truth.y, truth.z], axis=-1)
    ray = pattern.point(truth.u, truth.v) - points
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    inward = pattern.normal * np.sign(ray @ pattern.normal)[..., None]
    ratio = (1.0 if scene.medium is None else scene.medium.index) / _GLASS
    cosine = (ray * inward).sum(axis=-1, keepdims=True)
    inside = ratio * ray + (np.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine) * inward
    along = thickness / (inside * inward).sum(axis=-1, keepdims=True) * inside - thickness / cosine * ray
    return along @ pattern.u_axis / pattern.pitch, along @ pattern.v_axis / pattern.pitch


def _anchor(scene: Scene, z: Floats) -> PixelAnchor | None:
    """The edge at rest where it is in view by construction; else a known point beside the middle."""
    if isinstance(scene.camera, TelecentricCamera):
        return None
    seen = np.argwhere(np.isfinite(z))
    away = np.linalg.norm(seen - np.array([0.5, 0.2]) * z.shape, axis=1)
    row, col = seen[np.argmin(away)].tolist()
    return PixelAnchor(row, col, float(z[row, col]))
