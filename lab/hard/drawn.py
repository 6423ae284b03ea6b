"""What cases drawn at random have in common: a logarithmic scale, dents in units of the usual one, several
dents at once."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from optolever.experiments.arrays import Floats
from optolever.experiments.place import surface_of
from optolever.scene import Scene, Surface, dent

#: Forms of dents and the parameter that is their width ('': as wide as the mirror).
FORMS = {
    "raised-cosine": "",
    "gaussian": "sigma",
    "ball": "radius",
    "needle": "decay",
    "rounded-needle": "decay",
    "ridge": "sigma",
}


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number from low to high, logarithmically even."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def dent_params(form: str, scene: Scene, depth: float, width: float) -> dict[str, float]:
    """Peak and width (mm) of a dent of a form, so many times as deep and wide as the usual one of the scene;
    of a ball the radius, by which it is as wide."""
    usual = dent("gaussian", scene).formula
    assert usual is not None  # named forms have one
    params = {"peak": depth * usual.params["peak"]}
    if FORMS[form]:
        spread = width * usual.params["sigma"]
        params[FORMS[form]] = spread**2 / params["peak"] if form == "ball" else spread
    return params


def drawn_dent(rng: np.random.Generator) -> Callable[[Scene], Surface]:
    """A dent of any form, a twentieth to twice as deep as the usual one, somewhere on the mirror."""
    form = str(rng.choice(list(FORMS)))
    return partial(
        _placed,
        form,
        between(rng, 0.05, 2),
        between(rng, 0.2, 2),
        (float(rng.uniform(0.1, 0.85)), float(rng.uniform(0.1, 0.9))),
        float(rng.uniform(-90, 90)),
    )


def _placed(
    form: str, depth: float, width: float, place: tuple[float, float], angle: float, scene: Scene
) -> Surface:
    mirror, params = scene.mirror, dent_params(form, scene, depth, width)
    if FORMS[form]:
        params |= {"x": place[0] * mirror.length, "y": place[1] * mirror.width}
    if form == "ridge":
        params["angle_deg"] = angle
    return dent(form, scene, **params)


def together(dents: Sequence[Callable[[Scene], Surface]], scene: Scene) -> Surface:
    """All of the dents pressed at once: heights and slopes add up."""
    surfaces = [made(scene) for made in dents]

    def form(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        each = zip(*(surface.evaluate(x, y) for surface in surfaces), strict=True)
        z, slope_x, slope_y = (np.asarray(sum(parts)) for parts in each)
        return z, slope_x, slope_y

    return surface_of(form)
