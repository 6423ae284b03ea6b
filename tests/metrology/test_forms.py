"""Forms, Zernike terms and their sigmas, against closed forms and against noise that is drawn."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import InputError
from optolever.metrology import Numbers, fit_form, fit_zernike, form_names, zernike
from optolever.reconstruct import Diagnostics, HeightMap, SlopeMap, integrate

Floats = NDArray[np.float64]
PITCH, ROWS, COLS = 3.0, 60, 80
Y, X = np.mgrid[0:ROWS, 0:COLS] * PITCH
X0, Y0 = 100.0, 80.0  # vertex, off the middle
MIDDLE = PITCH * (COLS - 1) / 2, PITCH * (ROWS - 1) / 2


def height_map(z: Floats, good: Any = True, **more: Any) -> HeightMap:
    flags = np.where(np.broadcast_to(good, z.shape), 0, 128).astype(np.uint16)
    return HeightMap(X.astype(float), Y.astype(float), z, np.full(z.shape, 1e-4), flags, **more)


def conic(radius: float, constant: float) -> Floats:
    r2, c = (X - X0) ** 2 + (Y - Y0) ** 2, 1 / radius
    return np.asarray(c * r2 / (1 + np.sqrt(1 - (1 + constant) * c * c * r2)))


def along(degrees: float) -> tuple[Floats, Floats]:
    """Coordinates along and across an axis through the vertex."""
    a = np.radians(degrees)
    return np.cos(a) * (X - X0) + np.sin(a) * (Y - Y0), np.cos(a) * (Y - Y0) - np.sin(a) * (X - X0)


def tilted_cylinder() -> Floats:
    s, t = along(25)
    return 0.01 * s - (4000 - np.sqrt(4000**2 - t**2))


def aspheric(radius: float, constant: float, a4: float, a6: float) -> Floats:
    r2 = (X - X0) ** 2 + (Y - Y0) ** 2
    return conic(radius, constant) + a4 * r2**2 + a6 * r2**3


def segment(radius: float, constant: float, distance: float, azimuth: float) -> Floats:
    """Heights on a segment of a conic: points of the parent by its explicit sag, turned into the frame of the
    normal, and found at (X, Y) by Newton steps along the parent's own coordinates."""
    a, c = np.radians(azimuth), 1 / radius
    x, y = X - MIDDLE[0], Y - MIDDLE[1]
    u, v = np.cos(a) * x + np.sin(a) * y, np.cos(a) * y - np.sin(a) * x

    def sag(out: Any, across: Any) -> Any:
        r2 = out**2 + across**2
        return c * r2 / (1 + np.sqrt(1 - (1 + constant) * c * c * r2))

    lean = np.arctan((sag(distance + 1e-4, 0.0) - sag(distance - 1e-4, 0.0)) / 2e-4)
    out = distance + u * np.cos(lean)
    for _ in range(60):  # the point whose foot on the tangent plane is (u, v)
        up = sag(out, v) - sag(distance, 0.0)
        out = distance + (u - up * np.sin(lean)) / np.cos(lean)
    up = sag(out, v) - sag(distance, 0.0)
    return np.asarray(up * np.cos(lean) - (out - distance) * np.sin(lean))


SPHERE = 4000 - np.sqrt(4000**2 - (X - X0) ** 2 - (Y - Y0) ** 2)
FREE = {"radius": -600, "conic": -1.4, "azimuth_deg": -20, "tilt_x": 0, "piston": 0.1}
EXACT = {
    "sphere": (0.3 + SPHERE, {"radius": 4000, "vertex_z": 0.3}),
    "paraboloid": (((X - X0) ** 2 + (Y - Y0) ** 2) / (4 * -2000), {"focal": -2000}),
    "conic": (conic(300, -0.7), {"radius": 300, "conic": -0.7}),
    "conic:conic=-0.7": (conic(300, -0.7), {"radius": 300}),
    "sphere:radius=4000": (SPHERE, {"vertex_z": 0}),
    "tilt": (0.2 + 0.03 * X - 0.05 * Y, {"tilt_x": 0.03, "tilt_y": -0.05}),
    "asphere": (aspheric(300, 0, 2e-8, -3e-13), {"radius": 300, "a4": 2e-8, "a6": -3e-13}),
    "asphere:conic=-0.7,a4=2e-8,a6=0": (aspheric(300, -0.7, 2e-8, 0), {"radius": 300}),
    "asphere:conic=free,a4=2e-8,a6=-3e-13": (aspheric(300, -0.7, 2e-8, -3e-13), {"conic": -0.7}),
    "off-axis": (segment(600, -1, 200, 30), {"radius": 600, "distance": 200, "azimuth_deg": 30}),
    "off-axis:distance=200,conic=free": (0.1 + segment(-600, -1.4, 200, -20), FREE),
    # a sphere is the same anywhere, and tilted
    "off-axis:distance=100,azimuth_deg=40,conic=free": (conic(4000, 0), {"radius": 4000, "conic": 0}),
    "cylinder": (tilted_cylinder(), {"axis_deg": 25, "slope": 0.01, "radius": -4000}),
}


@pytest.mark.parametrize("form", EXACT)
def test_a_closed_form_is_found_and_leaves_nothing(form: str) -> None:
    z, stated = EXACT[form]
    fit = fit_form(height_map(z), form)
    found = dict(zip(fit.numbers.names, fit.numbers.values, strict=True)) | fit.held
    for name, value in stated.items():
        assert found[name] == pytest.approx(value, rel=1e-7, abs=1e-9), name
    if "vertex_x" in found:
        assert (found["vertex_x"], found["vertex_y"]) == pytest.approx(
            (X0 - MIDDLE[0], Y0 - MIDDLE[1]), abs=1e-6
        )
    assert fit.rms < 1e-10
    assert fit.middle == pytest.approx(MIDDLE)


def test_every_name_is_a_form() -> None:
    for name in form_names():
        assert fit_form(height_map(conic(500, -0.5)), name).form == name


def test_what_a_given_radius_leaves() -> None:
    """A sphere of 4010 mm against one of 4000 mm: r^2/2 (1/4010 - 1/4000), and its slope, to first order."""
    z = 4010 - np.sqrt(4010**2 - (X - MIDDLE[0]) ** 2 - (Y - MIDDLE[1]) ** 2)
    fit = fit_form(height_map(z), "sphere:radius=4000")
    change = 1 / 4010 - 1 / 4000
    quadratic = 0.5 * change * ((X - MIDDLE[0]) ** 2 + (Y - MIDDLE[1]) ** 2)
    assert fit.rms == pytest.approx(quadratic.std(), rel=2e-3)
    assert fit.pv == pytest.approx(np.ptp(quadratic), rel=2e-3)
    inner = np.gradient(quadratic, PITCH)
    assert fit.slope_rms == pytest.approx([np.sqrt(np.mean(part**2)) for part in inner[::-1]], rel=1e-2)


NOISY: dict[str, Any] = {
    "sphere": conic(4000, 0), "paraboloid": conic(4000, 0), "power": conic(4000, 0),
    "cylinder": tilted_cylinder(), "conic": conic(300, -0.7), "asphere": aspheric(300, 0, 2e-8, -3e-13),
    "off-axis": segment(600, -1, 200, 30), "off-axis:distance=200,conic=free": segment(600, -1, 200, 30),
}  # fmt: skip


def unknown_over_draws(one: Callable[[np.random.Generator], Numbers]) -> set[str]:
    """Names of the numbers without a sigma; of the others it is the scatter over 40 draws."""
    drawn = [one(np.random.default_rng(seed)) for seed in range(40)]
    known = np.isfinite(drawn[0].noise)
    ratio = np.std([each.values for each in drawn], axis=0)[known] / drawn[-1].noise[known]
    assert (ratio > 0.7).all()
    assert (ratio < 1.35).all()
    return {name for name, each in zip(drawn[0].names, known, strict=True) if not each}


@pytest.mark.daily(3)
@pytest.mark.parametrize("form", NOISY)
def test_sigmas_are_what_slope_noise_does(form: str) -> None:
    """40 draws of white slope noise, integrated by least squares; what hangs on the anchor has none."""
    s, z = 1e-5, NOISY[form]
    usual = Diagnostics("drawn", slope_sigma=(s, s))

    def one(rng: np.random.Generator) -> Numbers:
        drawn = integrate(*(s * rng.standard_normal((2, ROWS, COLS))), spacing=PITCH).z
        return fit_form(height_map(z + drawn, diagnostics=usual), form).numbers

    assert unknown_over_draws(one) <= {"vertex_z", "piston"}


def test_the_rigs_errors_are_in_sigma() -> None:
    """A mode that adds power moves the radius by d(1/R)."""
    z, mode = conic(4000, 0), 1e-9 * ((X - X0) ** 2 + (Y - Y0) ** 2)
    fit = fit_form(height_map(z, modes=mode[None].astype(np.float32)), "sphere")
    rig = fit.numbers.rig[fit.numbers.names.index("radius")]
    assert rig == pytest.approx(4000**2 * 2e-9, rel=1e-3)
    assert np.isnan(fit.numbers.noise).all()  # a file that does not say how noisy its slopes are


def test_orders_of_no_zernike_polynomial() -> None:
    for n, m in ((1, 0), (2, 3), (-1, 1)):
        with pytest.raises(InputError, match="must be n >= "):
            zernike(n, m, X, Y)


def test_the_outermost_ring_is_left_out() -> None:
    """Pixels that the mirror covers in part are wrong and enlarge the circle; a hole has no ring."""
    distance = np.hypot(X - MIDDLE[0], Y - MIDDLE[1])
    inside = distance < 60
    rim = inside & (distance > 60 - PITCH)
    z = np.where(rim, 1.0, 1e-3 * zernike(2, 2, distance / 60, np.arctan2(Y - MIDDLE[1], X - MIDDLE[0])))
    inside[ROWS // 2, COLS // 2] = False
    map_ = height_map(z, inside)
    for residual in (fit_form(map_, "tilt").residual, fit_zernike(map_, 2).residual):
        assert not np.isfinite(residual[rim]).any()
        assert np.count_nonzero(np.isnan(residual[distance < 60 - 3 * PITCH])) == 1
    assert fit_zernike(map_, 2).radius < 60 - 0.5 * PITCH


def test_zernike_sigmas_on_a_round_aperture_of_uneven_noise() -> None:
    """Noise that grows along x, told by a slope map."""
    inside = (X - MIDDLE[0]) ** 2 + (Y - MIDDLE[1]) ** 2 < 80**2
    s = 1e-5 * (0.5 + X / X.max())

    def one(rng: np.random.Generator) -> Numbers:
        weights, field = np.where(inside, s**-2, 1.0), s * rng.standard_normal((2, ROWS, COLS))
        map_ = height_map(integrate(*field, spacing=PITCH, mask=inside, weights=weights).z, inside)
        slopes = SlopeMap(map_.x, map_.y, map_.z, map_.z, s, s, map_.flags)
        return fit_zernike(map_, 3, slopes).numbers

    assert unknown_over_draws(one) == {"Z(0,0)"}


def test_too_few_pixels_are_refused() -> None:
    good = np.zeros((ROWS, COLS), np.bool_)
    good[3, 4:8] = True
    with pytest.raises(InputError, match="0 good pixels within the outermost ring, must be at least 8"):
        fit_form(height_map(conic(500, 0), good), "sphere")
    with pytest.raises(InputError, match="heights are flat"):
        fit_form(replace(height_map(np.zeros((ROWS, COLS)))), "sphere")
