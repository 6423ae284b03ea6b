"""Elastic contacts of known force (`pressed.py`), by kinds: force, depth and thickness against the truth.

On rigs as typed, or drawn from the priors of typed ones, against a rest capture; a dark contact hides the
places inside, a cut one is centred on the mirror's end.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from optolever.errors import InputError
from optolever.reconstruct import Contact, contacts, reconstruct
from optolever.scene import Layer, Scene, dent, load, resize, rig_covariance

from . import pressed
from .contacts import captured, changed

__all__ = ["ELASTIC", "Elastic", "elastic_figures", "elastic_scores"]

ELASTIC = (
    *("ball", "dark ball", "rounded punch", "dark rounded punch", "sharp punch"),
    *("cut x = 0", "cut x = L", "cut y = 0", "cut y = W", "two", "line", "L"),
    *("layer", "layer unknown", "fading"),
)
_PHOTONS = 0.004  # pattern pixels: noise of a place
_MODULUS = 0.25  # N/mm^2


@dataclass(frozen=True, slots=True)
class Elastic:
    """One elastic contact: true force (N, NaN: no pressure makes it), depth and thickness (mm, NaN: none is
    known), and the deepest contact that was found."""

    kind: str
    force: float
    depth: float
    thickness: float
    contact: Contact | None


def elastic_figures(kind: str, rigs: int, seed: int = 0, drawn: bool = False) -> Iterator[Elastic]:
    """Elastic contacts of one kind, on rigs as typed or drawn from the priors of typed ones."""
    scene = resize(load("prism48"), 112, 132)
    covariance = rig_covariance(scene)
    assert covariance is not None
    for number in range(rigs):
        rng = np.random.default_rng([61, seed, number, ELASTIC.index(kind)])
        dents, dark, thickness = _pressed(kind, scene, rng)
        layer = Layer(
            _MODULUS, thickness_mm=thickness if kind == "layer" else None, youngs_modulus_sigma_mpa=0
        )
        error = rng.standard_normal(len(covariance.root)) @ covariance.root
        true = changed(scene, error * drawn)
        surface = pressed.surface_of(dents)
        rest, _ = captured(true, dent("flat", scene), _PHOTONS, rng)
        places, traced = captured(true, surface, _PHOTONS, rng)
        flags = places.flags.copy()
        for each, x, y in dents[: len(dents) * dark]:
            flags[np.hypot(traced.x - x, traced.y - y) < each.radius] |= 1
        known = replace(scene if drawn else true, layer=layer)
        try:
            found = contacts(reconstruct(replace(places, flags=flags), known, rest=rest), layer)
        except InputError:  # the anchor is not in view
            continue
        one, x, y = dents[0]
        others = [other.load for other, *_ in dents[1:]] if kind != "two" else []
        newton = layer.plane_modulus * (one.load + sum(others))
        depth = max(float(surface.height(np.array([x]), np.array([y]))[0]) for _, x, y in dents)
        unknown = thickness if kind == "layer unknown" and thickness else np.nan
        yield Elastic(kind, newton, depth, unknown, max(found, key=lambda each: each.depth, default=None))


def _pressed(
    kind: str, scene: Scene, rng: np.random.Generator
) -> tuple[list[tuple[pressed.Dent, float, float]], bool, float | None]:
    """Dents with their places, whether they are dark, and the layer's thickness."""
    length, width = scene.mirror.length, scene.mirror.width
    x, y = (float(size * rng.uniform(0.35, 0.65)) for size in (length, width))
    a, d = float(rng.uniform(2.8, 4.5)), float(rng.uniform(0.012, 0.06))
    thickness = a * float(rng.uniform(4, 9)) if kind.startswith("layer") else None
    name = kind.removeprefix("dark ")
    if thickness is not None:
        one = pressed.on_layer(a, d, thickness, 0.5)
    elif name == "rounded punch":
        one = pressed.rounded_punch(a, d, 0.6)
    elif name in ("line", "L"):
        one = pressed.ball(2.5, d / 4)
    else:
        one = {"sharp punch": pressed.flat_punch(a, d / 2), "fading": pressed.gaussian(a, d)}.get(
            name, pressed.ball(a, d)
        )
    ends = {"cut x = 0": (0.0, y), "cut x = L": (length, y), "cut y = 0": (x, 0.0), "cut y = W": (x, width)}
    places = [ends.get(kind, (x, y))]
    steps = np.arange(1.0, 11.0)
    if kind == "two":
        places = [(x - 1.4 * a, y), (x + 1.4 * a, y)]
    elif kind == "line":
        places = [(x + step, y) for step in np.arange(-7.0, 8.0)]
    elif kind == "L":
        places += [(x + step, y) for step in steps] + [(x, y + step) for step in steps]
    return [(one, *place) for place in places], kind.startswith("dark"), thickness


def elastic_scores(some: list[Elastic]) -> dict[str, float]:
    """How many there are and were found; of force and depth the medians of errors and of sigmas, relative,
    rms and largest ratio of both; how many were taken for a layer, and the median error of its thickness."""
    found = [(one, one.contact) for one in some if one.contact is not None]
    scores = {"contacts": float(len(some)), "found": float(len(found))}
    for name in ("force", "depth"):
        given = [
            (getattr(each, name), getattr(each, f"{name}_sigma"), getattr(one, name)) for one, each in found
        ]
        value, sigma, true = np.array(given, np.float64).reshape(-1, 3).T
        if np.isfinite(value - true).any():
            off, ratio = np.abs(value / true - 1), np.abs(value - true) / sigma
            parts = np.median(off), np.median(sigma / true), np.sqrt(np.mean(ratio**2)), ratio.max()
            names = (f"{name} {part}" for part in ("error", "sigma", "ratio", "worst"))
            scores |= dict(zip(names, map(float, parts), strict=True))
    layers = [(each.layer_thickness, one.thickness) for one, each in found if each.layer_thickness]
    thick = [abs(h / true - 1) for h, true in layers if np.isfinite(true)]
    named = {"thickness error": float(np.median(thick))} if thick else {}
    return scores | {"layers": float(len(layers))} | named
