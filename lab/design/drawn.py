"""Numbers on a logarithmic scale; dents in units of a scene's default one."""

import numpy as np

from optolever.scene import Scene, dent

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
