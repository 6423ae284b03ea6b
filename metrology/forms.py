"""Forms of mirrors: parametric surfaces z(x, y). x, y are relative to the middle of the good pixels, mm.

| form | parameters | z |
|---|---|---|
| piston | piston | a constant |
| tilt | and tilt_x, tilt_y | a plane |
| power | and power (1/mm) | and power r^2 / 2 |
| paraboloid | vertex_x, vertex_y, vertex_z, focal | r^2 / (4 focal), r from the vertex |
| sphere | ..., radius | c r^2 / (1 + sqrt(1 - c^2 r^2)), c = 1 / radius |
| conic | ..., radius, conic | c r^2 / (1 + sqrt(1 - (1 + conic) c^2 r^2)) |
| asphere | ..., radius, conic (given, 0), a4, a6, a8 (given, 0) | conic + a4 r^4 + a6 r^6 + a8 r^8 |
| off-axis | piston, tilt_x, tilt_y, distance, azimuth_deg, radius, conic (given, -1) | see below |
| cylinder | axis_deg, slope, vertex_t, vertex_z, radius | slope s + a circle across, s along the axis |

off-axis: a segment of a conic of revolution (vertex radius, conic) whose middle lies `distance` from the
axis, in a direction azimuth_deg from x; tilt_x, tilt_y: slopes of the plane that touches it there. A number
that a form gives by default is fitted with NUMBER=free: off-axis:distance=100,conic=free.

Source of the conic's sag: D. Malacara, Optical Shop Testing, 3rd ed. (2007), appendix 1.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.numbers import parsed, written

__all__ = ["FORMS", "Form", "form_from_text", "form_names"]

#: Internal parameters of the model: curvatures instead of radii, to avoid a pole at a flat surface.
Model = Callable[[Floats, Floats, Floats], Floats]


@dataclass(frozen=True, slots=True)
class Form:
    """A model z(p, x, y) of internal parameters p (m,); names: of the stated parameters; start: p, or several
    (s, m), from the best quadric a + b x + c y + (d x^2 + 2 e x y + f y^2) / 2 (6,); stated, internal: p ->
    stated parameters, elementwise, and back; given: parameters that are fixed by default."""

    names: tuple[str, ...]
    model: Model
    start: Callable[[Floats], Floats]
    stated: Callable[[Floats], Floats]
    internal: Callable[[Floats], Floats]
    given: tuple[tuple[str, float], ...] = ()


def _same(p: Floats) -> Floats:
    return np.asarray(p, np.float64)


def _last_inverse(*places: int, factor: float = 1.0) -> Callable[[Floats], Floats]:
    """The parameters with factor / p in some places (an involution)."""

    def change(p: Floats) -> Floats:
        changed = np.array(p, np.float64)
        with np.errstate(divide="ignore"):
            for place in places:
                changed[place] = factor / changed[place]
        return changed

    return change


def _angle(place: int, unit: Callable[[Any], Any], inverse: int) -> Callable[[Floats], Floats]:
    """An angle in another unit, and the inverse of the parameter at another place."""

    def change(p: Floats) -> Floats:
        changed = _last_inverse(inverse)(p)
        changed[place] = unit(p[place])
        return changed

    return change


def _plane(p: Floats, x: Floats, y: Floats) -> Floats:
    z = p[0] + np.zeros_like(x)
    for slope, along in zip(p[1:3], (x, y), strict=False):
        z = z + slope * along
    return np.asarray(z + 0.5 * p[3] * (x * x + y * y) if len(p) > 3 else z)


def _sag(c: float, conic: float, r2: Floats) -> Floats:
    inside = 1 - (1 + conic) * c * c * r2
    return np.asarray(c * r2 / (1 + np.sqrt(np.maximum(inside, 0.0))))


def _revolved(conic: float | None) -> Model:
    """Surface of revolution about z through (p0, p1): vertex height p2, curvature p3, conic constant p4."""

    def model(p: Floats, x: Floats, y: Floats) -> Floats:
        k = p[4] if conic is None else conic
        return np.asarray(p[2] + _sag(p[3], k, (x - p[0]) ** 2 + (y - p[1]) ** 2))

    return model


def _asphere(p: Floats, x: Floats, y: Floats) -> Floats:
    r2 = (x - p[0]) ** 2 + (y - p[1]) ** 2
    return np.asarray(p[2] + _sag(p[3], p[4], r2) + r2 * r2 * (p[5] + r2 * (p[6] + r2 * p[7])))


def _off_axis(p: Floats, x: Floats, y: Floats) -> Floats:
    """Where the line along z at (x, y) meets the parent c (X^2 + Y^2 + (1 + k) Z^2) = 2 Z."""
    distance, azimuth, c, k = p[3:]
    sag = float(_sag(c, k, np.array(distance**2)))
    lean = np.arctan2(c * distance, 1 - (1 + k) * c * sag)  # slope of the parent at the middle
    cos, sin = np.cos(lean), np.sin(lean)
    normal = np.array([-p[1], -p[2], 1.0]) / np.sqrt(1 + p[1] ** 2 + p[2] ** 2)
    radial = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    radial[2] = radial[:2] @ p[1:3]
    radial /= np.linalg.norm(radial)
    frame = np.stack([radial, np.cross(normal, radial), normal])
    turn = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]]) @ frame
    metric, line = np.array([1.0, 1.0, 1 + k]), turn[:, 2]
    foot = np.array([distance, 0.0, sag]) + x[..., None] * turn[:, 0] + y[..., None] * turn[:, 1]
    a, b = c * float(line @ (metric * line)), c * foot @ (metric * line) - line[2]
    rest = c * np.square(foot) @ metric - 2 * foot[..., 2]
    return np.asarray(p[0] + rest / (np.sqrt(np.maximum(b * b - a * rest, 0.0)) - b))


def _curved(curvature: float) -> float:
    """InputError where it is 0."""
    if curvature == 0:
        raise InputError("form: the heights are flat, must be curved; remove tilt")
    return curvature


def _segment(q: Floats) -> Floats:
    """Segments (2, 7) of a paraboloid with the curvatures of a quadric, c cos^3 a along the azimuth, c cos a
    across; which end of its axis of symmetry is the near one, curvatures do not say."""
    values, vectors = np.linalg.eigh(np.array([[q[3], q[4]], [q[4], q[5]]]))
    radial, across = np.argsort(np.abs(values))
    strong = _curved(float(values[across]))
    cos = np.sqrt(np.clip(values[radial] / strong, 0.1, 1.0))
    c = float(strong / cos)
    azimuth = float(np.arctan2(vectors[1, radial], vectors[0, radial]))
    ends = (azimuth, azimuth - np.copysign(np.pi, azimuth))
    return np.array([[*q[:3], np.sqrt(1 / cos**2 - 1) / abs(c), each, c, -1.0] for each in ends])


def _stated_segment(p: Floats) -> Floats:
    """With radius for curvature, azimuth in degrees, distance above 0."""
    changed = _last_inverse(5)(p)
    changed[3] = abs(p[3])
    changed[4] = (np.degrees(p[4]) + (0 if p[3] >= 0 else 180) + 180) % 360 - 180
    return changed


def _vertex(q: Floats) -> Floats:
    """Vertex and mean curvature of a quadric."""
    c = _curved(0.5 * (q[3] + q[5]))
    x, y = -q[1] / c, -q[2] / c
    return np.array([x, y, q[0] - 0.5 * c * (x * x + y * y), c])


def _vertex_and(more: int) -> Callable[[Floats], Floats]:
    """The vertex of a quadric, then so many zeros."""
    return lambda q: np.append(_vertex(q), np.zeros(more))


def _cylinder(p: Floats, x: Floats, y: Floats) -> Floats:
    angle, slope, at, height, c = p
    along, across = np.cos(angle) * x + np.sin(angle) * y, -np.sin(angle) * x + np.cos(angle) * y
    return np.asarray(height + slope * along + _sag(c, 0.0, (across - at) ** 2))


def _of_quadric(q: Floats) -> Floats:
    """Parameters of a cylinder from a quadric, by its direction of largest curvature."""
    values, vectors = np.linalg.eigh(np.array([[q[3], q[4]], [q[4], q[5]]]))
    strong = int(np.argmax(np.abs(values)))
    c, across = _curved(float(values[strong])), vectors[:, strong]
    angle = float(np.arctan2(-across[0], across[1]))
    angle = (angle + np.pi / 2) % np.pi - np.pi / 2
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    at = -float(q[1:3] @ across) / c
    return np.array([angle, float(q[1:3] @ along), at, q[0] - 0.5 * c * at * at, c])


_VERTEX = ("vertex_x", "vertex_y", "vertex_z")
_RADIUS = 2 * (_last_inverse(3),)
_SEGMENT = ("piston", "tilt_x", "tilt_y", "distance", "azimuth_deg", "radius", "conic")
_CYLINDER = ("axis_deg", "slope", "vertex_t", "vertex_z", "radius")
_PLANE = ("piston", "tilt_x", "tilt_y", "power")


def _planar(count: int) -> Form:
    def start(q: Floats) -> Floats:
        return np.array([*q[:3], 0.5 * (q[3] + q[5])])[:count]

    return Form(_PLANE[:count], _plane, start, _same, _same)


FORMS: dict[str, Form] = {
    "piston": _planar(1),
    "tilt": _planar(3),
    "power": _planar(4),
    "paraboloid": Form((*_VERTEX, "focal"), _revolved(-1.0), _vertex, *2 * (_last_inverse(3, factor=0.5),)),
    "sphere": Form((*_VERTEX, "radius"), _revolved(0.0), _vertex, *_RADIUS),
    "conic": Form((*_VERTEX, "radius", "conic"), _revolved(None), _vertex_and(1), *_RADIUS),
    "asphere": Form(
        (*_VERTEX, "radius", "conic", "a4", "a6", "a8"),
        *(_asphere, _vertex_and(4), *_RADIUS),
        (("conic", 0.0), ("a8", 0.0)),
    ),
    "off-axis": Form(
        _SEGMENT, _off_axis, _segment, _stated_segment, _angle(4, np.radians, 5), (("conic", -1.0),)
    ),
    "cylinder": Form(_CYLINDER, _cylinder, _of_quadric, _angle(0, np.degrees, 4), _angle(0, np.radians, 4)),
}


def form_names() -> tuple[str, ...]:
    """Names of the forms of `fit_form`."""
    return tuple(FORMS)


def form_from_text(text: str) -> tuple[str, Form, dict[str, float]]:
    """'sphere' or 'conic:radius=4000,conic=-1': name, form and fixed parameters. InputError for an unknown
    name or parameter."""
    name, _, rest = text.partition(":")
    if name not in FORMS:
        raise InputError(f"form {text!r}: unknown, must be one of {', '.join(FORMS)}")
    form = FORMS[name]
    held, what = dict(form.given), f"form {text!r}"
    for key, value in written(what, rest, f"NUMBER=VALUE of {', '.join(form.names)}", form.names).items():
        if value == "free":
            held.pop(key, None)
            continue
        held[key] = parsed(f"{what}: {key}", value)
        if key in ("radius", "focal") and held[key] == 0:
            raise InputError(f"{what}: {key} is 0 mm, must not be 0; below 0 where convex")
    return name, form, held
