"""Dents by name: their parameters, the defaults that suit a scene, and the surfaces they make;
a dent from an image."""

import math
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from optolever import InputError
from optolever.numbers import parsed, written
from optolever.pictures import grey_of, read_picture

from .dent_forms import FORMS, taper_of
from .fields import Float, number, positive
from .scene import Scene
from .surface import Both, Formula, Grid, Surface, from_grid

__all__ = ["dent", "dent_from_text", "dent_names", "dent_parameters"]

_TAPER = 0.1  # share of the mirror's length, at x = L0, over which dents fade to zero
_PEAK = 1.3 / 163.7  # default peak over the mirror's shorter side: paper-simulation's 1.3 mm
_DECAY = 10 / 163.7  # likewise the needle's 10 mm
_SIGMA = 20 / 163.7  # and the Gaussian's 20 mm: the image does not fold (peak/sigma^2 below 1/(2 x))
_NODES = 2048  # nodes along a side; larger images are averaged down
_ZEROS = 12  # nodes at x = L0 that are exactly zero, so that the spline is too (it forgets by 0.27 per node)

Params = dict[str, float]


def _defaults(scene: Scene) -> dict[str, Params]:
    """Parameters by dent, as they suit a mirror."""
    length, width = scene.mirror.length, scene.mirror.width
    size = min(length, width)
    cosine = {"peak": _PEAK * size}
    centred = {**cosine, "x": 0.5 * length, "y": 0.5 * width}
    gaussian, needle = centred | {"sigma": _SIGMA * size}, centred | {"decay": _DECAY * size}
    return {
        "flat": {},
        "tilt": {"slope": 0.001},
        "raised-cosine": cosine,
        "gaussian": gaussian,
        "ball": centred | {"radius": (_SIGMA * size) ** 2 / cosine["peak"]},
        "needle": needle,
        "rounded-needle": needle | {"rounding": 0.1 * needle["decay"]},
        "ridge": gaussian | {"angle_deg": 0.0},
        "relief": cosine | {"smooth": 0.01 * size},
    }


_POSITIVE = {"sigma", "radius", "decay", "rounding", "peak"}
_TEXTS = {"relief": ("path",)}


def dent_names() -> tuple[str, ...]:
    """The names that `dent` knows."""
    return (*FORMS, "relief")


def dent_parameters(name: str, scene: Scene) -> dict[str, Any]:
    """Parameters of a named dent and their defaults on a scene's mirror (mm); None: it must be given."""
    if name not in dent_names():
        raise InputError(f"dent {name!r}: unknown, must be one of {', '.join(dent_names())}")
    return {**dict.fromkeys(_TEXTS.get(name, ())), **_defaults(scene)[name]}


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
        return _relief(scene, taper=_TAPER * scene.mirror.length, **values)
    formula = Formula(name, _complete(name, scene, values))
    form = partial(FORMS[name], **formula.params)
    return Surface(partial(_height, form), partial(_gradient, form), formula, both=form)


def _height(form: Both, x: Float, y: Float) -> Float:
    return form(x, y)[0]


def _gradient(form: Both, x: Float, y: Float) -> tuple[Float, Float]:
    return form(x, y)[1:]


def dent_from_text(text: str, scene: Scene) -> Surface:
    """The dent that the command line writes as 'gaussian:peak=1.3,sigma=20' (or just 'gaussian')."""
    name, params = _from_text(text)
    return dent(name, scene, **params)


def _from_text(text: str) -> tuple[str, dict[str, Any]]:
    """Name and parameters of the command line's form."""
    name, _, rest = text.partition(":")
    params: dict[str, Any] = dict(written(f"dent {text!r}", rest, "parameter=value"))
    for key in params.keys() - set(_TEXTS.get(name.strip(), ())):
        params[key] = parsed(f"dent {text!r}: {key}", params[key])
    return name.strip(), params


def _checked(name: str, scene: Scene, params: dict[str, Any]) -> dict[str, Any]:
    """Defaults overridden by params, all checked."""
    values = dent_parameters(name, scene)
    for key, value in params.items():
        if key not in values:
            raise InputError(
                f"dent {name!r}: unknown parameter {key!r}: must be one of {', '.join(values) or '(none)'}"
            )
        values[key] = value if key in _TEXTS.get(name, ()) else number(f"dent {name!r}: {key}", value)
    for key in _TEXTS.get(name, ()):
        if not isinstance(values[key], str) or not values[key]:
            raise InputError(f"dent {name!r}: parameter {key!r} is missing, must name a file")
    for key in _POSITIVE & values.keys():
        if key != "peak":
            positive(f"dent {name!r}: {key}", values[key])
    if name == "ball":
        positive(f"dent {name!r}: peak", values["peak"])
    most = max(scene.mirror.length, scene.mirror.width)
    if abs(values.get("peak", 0.0)) > most:
        wrong = f"dent {name!r}: peak = {values['peak']:g}: must be at most the mirror's size, {most:g} mm"
        raise InputError(f"{wrong}; divide micrometres by 1000")
    return values


def _complete(name: str, scene: Scene, values: Params) -> Params:
    """The formula's params from the user's: derived ones added, in the form that GLSL takes."""
    length, width = scene.mirror.length, scene.mirror.width
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


def _relief(scene: Scene, *, path: str, peak: float, smooth: float, taper: float) -> Surface:
    """Surface whose height is the image at `path`, stretched over the mirror: black 0, white `peak` mm.

    Columns run along x, rows along y; of colours their luminance. smooth: rms radius (mm) of a Gaussian
    blur that turns the image's steps into slopes; taper: mm over which the height fades out towards x = L0.
    """
    positive("dent 'relief': smooth", smooth, zero=True)
    heights = peak * _grey(Path(path))
    heights = _fitted(heights)
    rows, cols = heights.shape
    dx, dy = scene.mirror.length / (cols - 1), scene.mirror.width / (rows - 1)
    if smooth > 0:
        heights = np.asarray(
            cv2.GaussianBlur(
                heights, (0, 0), smooth / dx, sigmaY=smooth / dy, borderType=cv2.BORDER_REPLICATE
            ),
            np.float64,
        )
    fade, _ = taper_of(dx * (np.arange(cols) + _ZEROS), scene.mirror.length, taper)
    grid = Grid(heights * fade, 0.0, 0.0, dx, dy)
    return from_grid(grid)


def _grey(path: Path) -> Float:
    """The image as 0..1 (rows, cols); InputError if it is none."""
    grey = grey_of(read_picture(path))
    return grey.astype(np.float64) / {"uint8": 255.0, "uint16": 65535.0}.get(grey.dtype.name, 1.0)


def _fitted(heights: Float) -> Float:
    """At most _NODES nodes along a side, by area; at least enough for the taper's zeros."""
    least = 10 * _ZEROS
    rows, cols = (min(max(side, least), _NODES) for side in heights.shape)
    if (rows, cols) == heights.shape:
        return heights
    shrinks = rows <= heights.shape[0] and cols <= heights.shape[1]
    how = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(heights, (cols, rows), interpolation=how), np.float64)
