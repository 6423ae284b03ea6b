"""Every formula of the pages, and every number that they derive from one, holds: by ray tracing, by rendered
frames, or by brute force.

`holds(page, text, ...)` names what a test is about: the page must say it, and a formula without a test fails.
"""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import reconstruct
from optolever.patterns import Frame, Sequence
from optolever.projector import capture
from optolever.scene import (
    Bow,
    Display,
    Medium,
    Mirror,
    Scene,
    Sensor,
    Surface,
    TelecentricCamera,
    Trace,
    load,
    prism_camera,
    prism_pattern,
    resize,
    trace,
)

from .test_pages import ROOT

Floats = NDArray[np.float64]
Test = TypeVar("Test", bound=Callable[..., None])
HELD: list[tuple[str, str]] = []
#: Pages that state formulas.
ANCHOR, GEOMETRY = "docs/explanation/anchor.md", "docs/explanation/geometry.md"
MONITOR, PRISM = "docs/rig/monitor.md", "docs/rig/prism.md"
CAPTURE, SCENE, LIMITS = "docs/reference/capture.md", "docs/reference/scene.md", "docs/limits.md"


def text_of(page: str) -> str:
    """A page on one line."""
    return " ".join((ROOT / page).read_text().split())


def holds(page: str, *texts: str) -> Callable[[Test], Test]:
    """Mark a test as the one of what a page says."""
    HELD.extend((page, text) for text in texts)
    return lambda test: test


def number(page: str, pattern: str) -> float:
    """The number that a page says: the group of a pattern in which blanks are any white space."""
    found = re.search(pattern, text_of(page))
    assert found is not None, f"{page} does not say {pattern!r}"
    return float(found[1])


def said(value: float, digits: int) -> Any:
    """What a page may say of a value: rounded to this many digits behind the point."""
    return pytest.approx(value, abs=0.5000001 * 10.0**-digits)


def test_pages_say_what_is_held() -> None:
    for page, text in HELD:
        assert text in text_of(page), f"{page}: {text}"


# Rigs


def prism(degrees: float, rows: int = 3, cols: int = 61, index: float | None = None) -> Scene:
    """A prism of equal angles, mirror of 100 x 60 mm, pattern on all of its face and beyond it along y."""
    angle, length, width = math.radians(degrees), 100.0, 60.0
    face = 0.5 * length / math.cos(angle)
    pattern = prism_pattern(angle, rows=4000, cols=round(face / 0.05), pitch=0.05)
    pattern = replace(pattern, origin=pattern.origin - np.array([0.0, 70.0, 0.0]))
    pitch = np.array([length * math.cos(angle) / cols, width / rows])
    medium = None if index is None else Medium(index)
    camera = prism_camera(length, angle, rows, cols, pitch)
    return Scene("prism", Mirror(length, width), pattern, camera, medium)


def plane(slope_x: float, slope_y: float, x0: float = 0.0, y0: float = 0.0) -> Surface:
    """A plane through (x0, y0, 0)."""
    return Surface(
        lambda x, y: slope_x * (x - x0) + slope_y * (y - y0),
        lambda x, y: (np.full_like(x, slope_x), np.full_like(x, slope_y)),
    )


def parabola(curvature: float, x0: float, y0: float, along: str) -> Surface:
    """A trough of this curvature at (x0, y0), hollow towards the light if it is above 0."""

    def part(x: Floats, y: Floats) -> Floats:
        return x - x0 if along == "x" else y - y0

    def gradient(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        slope, none = curvature * part(x, y), np.zeros_like(x)
        return (slope, none) if along == "x" else (none, slope)

    return Surface(lambda x, y: 0.5 * curvature * part(x, y) ** 2, gradient)


def places(rig: Scene, seen: Trace) -> tuple[Floats, Floats]:
    """Points on the mirror and on the pattern, mm, (H, W, 3)."""
    mirror = np.stack([seen.x, seen.y, seen.z], axis=-1)
    u, v = (rig.pattern.pitch * one[..., None] for one in (seen.u, seen.v))
    return mirror, rig.pattern.origin + u * rig.pattern.u_axis + v * rig.pattern.v_axis


def bisected(holds_at: Callable[[float], bool], inside: float, outside: float) -> float:
    """Where a condition ends that holds at `inside` and not at `outside`."""
    assert holds_at(inside)
    assert not holds_at(outside)
    for _ in range(40):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if holds_at(middle) else (inside, middle)
    return inside


# Reflection


@holds(
    GEOMETRY,
    "theta = atan(dz/dx) be the slope angle",
    r"$$\alpha = \beta + 2\,\theta .$$",
    "sees a **smaller u**",
)
@holds(PRISM, "the reflection moves by twice the slope")
@pytest.mark.parametrize("degrees", [45.0, 48.0, 60.0])
@pytest.mark.parametrize("theta", [-0.05, 0.01, 0.08])
def test_reflected_angles(degrees: float, theta: float) -> None:
    rig = prism(degrees)
    middle = 0.5 * rig.mirror.length
    seen, flat = (trace(rig, plane(slope, 0.0, middle)) for slope in (math.tan(theta), 0.0))
    (mirror, pattern), (_, ray) = places(rig, seen), rig.camera.rays()
    beta = np.arctan2(-ray[..., 0], -ray[..., 2])  # towards the camera, from the normal at rest
    way = pattern - mirror
    alpha = np.arctan2(-way[..., 0], way[..., 2])  # to the other side, towards the pattern
    near = seen.visible & flat.visible
    assert near.sum() > 50
    assert np.allclose(alpha[near], (beta + 2 * theta)[near], atol=1e-9)
    assert np.all((seen.u < flat.u)[near] == (theta > 0))


# Which slopes reach the pattern, and by total reflection


@holds(
    GEOMETRY, "slopes from -atan((L0 - x)/x)/2 to +22.5 degrees reach the pattern; at mid-span ±22.5 degrees"
)
@holds(LIMITS, "measurable from -atan((L0 - x)/x)/2 to +22.5 degrees")
@pytest.mark.parametrize("col", [6, 20, 30, 40, 54])
def test_slopes_that_reach_the_pattern(col: int) -> None:
    rig = prism(45.0)
    x = float(trace(rig, plane(0.0, 0.0)).x[1, col])

    def reaches(theta: float) -> bool:
        return bool(trace(rig, plane(math.tan(theta), 0.0, x)).visible[1, col])

    lowest, highest = bisected(reaches, 0.0, -1.2), bisected(reaches, 0.0, 1.2)
    formula = -0.5 * math.atan((rig.mirror.length - x) / x)
    assert math.degrees(lowest) == pytest.approx(
        math.degrees(formula), abs=0.1
    )  # the face ends in whole cells
    assert math.degrees(highest) == pytest.approx(22.5, abs=0.1)
    if col == 30:
        assert math.degrees(lowest) == pytest.approx(-22.5, abs=0.1)


def total_reflection(degrees: float, index: float) -> float:
    """Largest slope, degrees, up to which a prism's middle reflects all light whatever the slope's sign."""
    rig = prism(degrees, index=index)
    medium = rig.medium
    assert medium is not None

    def total(theta: float) -> bool:
        pair = [trace(rig, plane(sign * math.tan(theta), 0.0, 50.0)) for sign in (-1, 1)]
        assert all(seen.visible[1, 30] for seen in pair)
        return all(medium.reflectance(np.cos(seen.incidence[1, 30])) == 1.0 for seen in pair)

    return math.degrees(bisected(total, 0.0, 0.2))


@holds(
    PRISM,
    "Total reflection at the base needs an angle of incidence above asin(1/n).",
    "at 45 degrees half of a dent loses it",
)
def test_total_reflection() -> None:
    """The boundary's waves by Fresnel: the tangent form, which knows of no critical angle."""
    index = number(PRISM, r"With n = ([\d.]+) \(silicone\)")

    def lets_through(beta: float) -> bool:
        beyond = math.sin(beta) * index
        if beyond >= 1:
            return False
        out = math.asin(beyond)
        s, p = math.sin(beta - out) / math.sin(beta + out), math.tan(beta - out) / math.tan(beta + out)
        assert Medium(index).reflectance(np.cos(beta)) == pytest.approx(0.5 * (s * s + p * p))
        return True

    critical = math.degrees(bisected(lets_through, 0.1, 1.5))
    assert number(PRISM, r"\(silicone\) that is ([\d.]+) degrees") == said(critical, 1)
    slopes = {48.0: r"of 48 degrees .* slopes of ([\d.]+) degrees", 50.0: r"50 degrees up to ([\d.]+)\."}
    for degrees, pattern in slopes.items():
        assert number(PRISM, pattern) == said(total_reflection(degrees, index), 1)
    geometry = r"n = 1\.41 and 48 degrees allow ([\d.]+) degrees of slope"
    assert number(GEOMETRY, geometry) == said(total_reflection(48.0, 1.41), 1)


# Where the image folds


@holds(GEOMETRY, "concave towards the light with a curvature above about 1/(2x) along x, 1/x across it")
@pytest.mark.parametrize("col", [10, 30, 45])
@pytest.mark.parametrize(("along", "times"), [("x", 2.0), ("y", 1.0)])
def test_curvature_at_which_the_image_folds(col: int, along: str, times: float) -> None:
    rig = prism(45.0)
    x = float(trace(rig, plane(0.0, 0.0)).x[1, col])
    near = magnified(rig, 1, col)

    def order(curvature: float) -> float:
        """Sign of the pattern's order along the axis of the trough."""
        seen = trace(near, parabola(curvature, x, 30.0, along))
        return float(np.sign((np.diff(seen.u, axis=1) if along == "x" else np.diff(seen.v, axis=0)).mean()))

    fold = bisected(lambda one: order(one) == order(0.0), 0.0, 4 / x)
    assert fold == pytest.approx(1 / (times * x), rel=2e-3)
    assert order(-4 / x) == order(0.0)


def magnified(rig: Scene, row: int, col: int) -> Scene:
    """Seen by 3 x 3 tiny pixels about one of the camera's."""
    camera = rig.camera
    assert isinstance(camera, TelecentricCamera)
    tiny = 0.01 * camera.pitch
    along, across = np.array([col, row]) * camera.pitch - tiny
    place = camera.origin + along * camera.u_axis + across * camera.v_axis
    return replace(rig, camera=replace(camera, origin=place, pitch=tiny, rows=3, cols=3))


# The free mode


@holds(ANCHOR, "For a prism of 45 degrees with parallel rays the mode is proportional to x")
def test_the_free_mode_of_45_degrees() -> None:
    """Turned about the edge x = 0 the mirror shows every pixel the same place, to first order."""
    rig = resize(load("paper-simulation"), 30, 40)
    seen = trace(rig, plane(0.0, 0.0))
    mode = reconstruct.null_space(rig)
    known = np.isfinite(mode)
    assert known.mean() > 0.8
    assert np.nanmax(mode) == pytest.approx(1.0)
    assert np.allclose((mode / seen.x)[known], 1 / np.nanmax(seen.x), rtol=1e-6)
    slope = 1e-3
    turned, half = (trace(rig, plane(one, 0.0)) for one in (slope, slope / 2))
    shifts = [np.nanmax(np.abs(one.u - seen.u)) for one in (turned, half)]
    lifted = trace(rig, Surface(lambda x, y: np.full_like(x, 50 * slope), plane(0.0, 0.0).gradient))
    assert shifts[0] < 0.01 * np.nanmax(np.abs(lifted.u - seen.u))
    assert shifts[0] / shifts[1] == pytest.approx(4.0, rel=0.1)  # of second order


# Light


@holds(SCENE, "Light of level g (0..255), relative to that of 255: black + (1 - black) (g/255)^gamma.")
@holds(SCENE, "level = offset + 255 (exposure light)^(1/gamma), clipped to 0..255")
def test_levels_of_a_camera() -> None:
    display, sensor = Display(gamma=2.2, black=0.05), Sensor(gamma=1.8, exposure=0.7, offset=12.0)
    rig = replace(prism(50.0), display=display, sensor=sensor, medium=None)
    for shown in (0, 60, 140, 255):
        uniform = Sequence((Frame("uniform", level=shown),), rig.pattern.rows, rig.pattern.cols)
        frame = capture(rig, plane(0.0, 0.0), uniform, renderer="numpy").frames[0]
        light = 0.05 + 0.95 * (shown / 255) ** 2.2
        assert np.abs(frame[1, 20:40] - (12.0 + 255 * (0.7 * light) ** (1 / 1.8))).max() <= 0.51, shown


@holds(SCENE, "w = b20 U² + b11 U V + b02 V² (mm along the pattern's normal u x v)")
def test_a_bent_display() -> None:
    rig = resize(load("prism48"), 30, 40)
    bow = replace(Bow.of_pattern(rig.pattern.rows, rig.pattern.cols), b20=0.3, b11=-0.2, b02=0.1)
    bent = replace(rig, pattern=replace(rig.pattern, shape=bow))
    seen = trace(bent, plane(0.0, 0.0))
    (mirror, flat), (_, ray) = places(bent, seen), rig.camera.rays()
    upper = (2 * seen.u + 1 - rig.pattern.cols) / rig.pattern.cols
    left = (2 * seen.v + 1 - rig.pattern.rows) / rig.pattern.rows
    lifted = flat + (0.3 * upper**2 - 0.2 * upper * left + 0.1 * left**2)[..., None] * np.cross(
        rig.pattern.u_axis, rig.pattern.v_axis
    )
    off = np.cross(lifted - mirror, ray * [1, 1, -1])  # the mirror at rest turns z
    assert np.nanmax(np.abs(off)) < 1e-6
