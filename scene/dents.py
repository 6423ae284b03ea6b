"""Dents by name: their parameters, the defaults that suit a scene, and the surfaces they make."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from optolever import InputError

from .forms import FORMS
from .record import number, positive
from .relief import relief
from .scene import Scene
from .surface import Formula, Surface

__all__ = ["dent", "dent_from_text", "dent_names", "dent_parameters", "moving_dent"]

_TAPER = 0.1  # share of the mirror's length, at x = L0, over which dents fade to zero
_PEAK = 1.3 / 163.7  # default peak over the mirror's shorter side: paper-simulation's 1.3 mm
_DECAY = 10 / 163.7  # likewise the needle's 10 mm
_SIGMA = 20 / 163.7  # and the Gaussian's 20 mm: the image does not fold (peak/sigma^2 below 1/(2 x))

Params = dict[str, float]


def _sizes(scene: Scene) -> tuple[float, float, float]:
    return scene.mirror.length, scene.mirror.width, min(scene.mirror.length, scene.mirror.width)


def _flat(scene: Scene) -> Params:
    return {}


def _tilt(scene: Scene) -> Params:
    return {"slope": 0.001}


def _cosine(scene: Scene) -> Params:
    return {"peak": _PEAK * _sizes(scene)[2]}


def _centred(scene: Scene) -> Params:
    length, width, _ = _sizes(scene)
    return {**_cosine(scene), "x": 0.5 * length, "y": 0.5 * width}


def _gaussian(scene: Scene) -> Params:
    return {**_centred(scene), "sigma": _SIGMA * _sizes(scene)[2]}


def _ball(scene: Scene) -> Params:
    contact = _SIGMA * _sizes(scene)[2]
    return {**_centred(scene), "radius": contact**2 / _cosine(scene)["peak"]}


def _needle(scene: Scene) -> Params:
    return {**_centred(scene), "decay": _DECAY * _sizes(scene)[2]}


def _rounded(scene: Scene) -> Params:
    return {**_needle(scene), "rounding": 0.1 * _needle(scene)["decay"]}


def _ridge(scene: Scene) -> Params:
    return {**_gaussian(scene), "angle_deg": 0.0}


def _relief(scene: Scene) -> Params:
    return {**_cosine(scene), "smooth": 0.01 * _sizes(scene)[2]}


_DEFAULTS: dict[str, Callable[[Scene], Params]] = {
    "flat": _flat,
    "tilt": _tilt,
    "raised-cosine": _cosine,
    "gaussian": _gaussian,
    "ball": _ball,
    "needle": _needle,
    "rounded-needle": _rounded,
    "ridge": _ridge,
    "relief": _relief,
}
_POSITIVE = {"sigma", "radius", "decay", "rounding", "peak"}
_TEXTS = {"relief": ("path",)}


def dent_names() -> tuple[str, ...]:
    """The names that `dent` knows."""
    return tuple(_DEFAULTS)


def dent_parameters(name: str, scene: Scene) -> dict[str, Any]:
    """Parameters of a named dent and their defaults on a scene's mirror (mm); None: it must be given."""
    if name not in _DEFAULTS:
        raise InputError(f"dent {name!r}: unknown, must be one of {', '.join(_DEFAULTS)}")
    return {**dict.fromkeys(_TEXTS.get(name, ())), **_DEFAULTS[name](scene)}


def dent(name: str, scene: Scene, **params: Any) -> Surface:
    """The named dent on the scene's mirror; parameters (mm) default to suit the mirror's size. The name
    may be the command line's text: `dent("gaussian:peak=0.3", scene)`.

    | name | parameters |
    |---|---|
    | flat | |
    | tilt | slope |
    | raised-cosine | peak |
    | gaussian | peak, sigma, x, y |
    | ball | peak, radius (of the ball), x, y |
    | needle | peak, decay, x, y |
    | rounded-needle | peak, decay, rounding, x, y |
    | ridge | peak, sigma, x, y, angle_deg (0: along y) |
    | relief | path (of an image: columns along x, rows along y), peak (of white), smooth (a blur's rms) |

    InputError on an unknown name or parameter, or a value out of range.
    """
    if ":" in name:
        name, written = _from_text(name)
        twice = next(iter(written.keys() & params.keys()), None)
        if twice is not None:
            raise InputError(f"dent {name!r}: parameter {twice!r} is given twice, must be given once")
        params = written | params
    values = _checked(name, scene, params)
    if name == "relief":
        return relief(scene, taper=_TAPER * scene.mirror.length, **values)
    formula = Formula(name, _complete(name, scene, values))
    form = partial(FORMS[name], **formula.params)
    return Surface(lambda x, y: form(x, y)[0], lambda x, y: form(x, y)[1:], formula, both=form)


def dent_from_text(text: str, scene: Scene) -> Surface:
    """The dent that the command line writes as 'gaussian:peak=1.3,sigma=20' (or just 'gaussian')."""
    name, params = _from_text(text)
    return dent(name, scene, **params)


def _from_text(text: str) -> tuple[str, dict[str, Any]]:
    """Name and parameters of the command line's form."""
    name, _, rest = text.partition(":")
    params: dict[str, Any] = {}
    for item in filter(None, rest.split(",")):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not key or not value:
            raise InputError(f"dent {text!r}: {item!r} must read parameter=value")
        if key in params:
            raise InputError(f"dent {text!r}: parameter {key!r} is given twice, must be given once")
        params[key] = value if key in _TEXTS.get(name.strip(), ()) else _parsed(text, key, value)
    return name.strip(), params


def moving_dent(
    name: str, scene: Scene, rates: dict[str, float], **params: Any
) -> Callable[[float], Surface]:
    """A dent whose parameters change evenly: value + rate t, t in seconds; e.g. rates={'x': 20.0}."""
    start = _checked(name, scene, params)
    for key in rates:
        if key not in start or isinstance(start[key], str):
            raise InputError(f"dent {name!r}: unknown rate {key!r}: must be one of {', '.join(start)}")

    def at(seconds: float) -> Surface:
        return dent(
            name, scene, **{**start, **{key: start[key] + rate * seconds for key, rate in rates.items()}}
        )

    return at


def _parsed(text: str, key: str, value: str) -> float:
    try:
        return float(value)
    except ValueError as error:
        raise InputError(f"dent {text!r}: {key} = {value!r}: must be a number") from error


def _checked(name: str, scene: Scene, params: dict[str, Any]) -> dict[str, Any]:
    """Defaults overridden by params, all checked."""
    if name not in _DEFAULTS:
        raise InputError(f"dent {name!r}: unknown, must be one of {', '.join(_DEFAULTS)}")
    values: dict[str, Any] = dict(_DEFAULTS[name](scene))
    known = (*_TEXTS.get(name, ()), *values)
    for key, value in params.items():
        if key not in known:
            raise InputError(
                f"dent {name!r}: unknown parameter {key!r}: must be one of {', '.join(known) or '(none)'}"
            )
        values[key] = value if key in _TEXTS.get(name, ()) else number(f"dent {name!r}: {key}", value)
    for key in _TEXTS.get(name, ()):
        if not isinstance(values.get(key), str) or not values[key]:
            raise InputError(f"dent {name!r}: parameter {key!r} is missing, must name a file")
    for key in _POSITIVE & values.keys():
        if key != "peak":
            positive(f"dent {name!r}: {key}", values[key])
    if name == "ball":
        positive(f"dent {name!r}: peak", values["peak"])
    return values


def _complete(name: str, scene: Scene, values: Params) -> Params:
    """The formula's params from the user's: derived ones added, in the form that GLSL takes."""
    length, width, _ = _sizes(scene)
    params = dict(values)
    if name == "raised-cosine":
        return {**params, "kx": 2 * math.pi / length, "ky": 2 * math.pi / width}
    if name == "tilt":
        return {**params, "length": length}
    if name == "ball":
        params["contact"] = math.sqrt(params["peak"] * params.pop("radius"))
    if name == "ridge":
        angle = math.radians(params.pop("angle_deg"))
        params |= {"nx": math.cos(angle), "ny": math.sin(angle)}
    return {**params, "length": length, "taper": _TAPER * length} if params else params
