"""Contacts of maps in closed form: Hertz' ball (K. L. Johnson, Contact Mechanics, 1985, eq. 3.42)."""

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.interpolate
import scipy.special

from optolever.contact import Surface, contacts, load_fit, regions
from optolever.scene import Layer

X, Y = np.meshgrid(np.linspace(0, 60, 160), np.linspace(0, 45, 120))


EDGE = np.stack([np.full(9, 60.0), np.linspace(0, 45, 9)], axis=-1)  # where the mirror counts as at rest


def ball(cx: float, cy: float, radius: float, depth: float) -> np.ndarray:
    """Depth under and around a ball on a half-space; its own radius is radius^2 / depth."""
    q = np.hypot(X - cx, Y - cy) / radius
    far = np.maximum(q, 1.0)
    out = depth / np.pi * ((2 - far**2) * np.arcsin(1 / far) + np.sqrt(far**2 - 1))
    return np.where(q < 1, depth * (1 - q**2 / 2), out)


def surface(z: np.ndarray, noise: float = 5e-5, **more: object) -> Surface:
    rng = np.random.default_rng(0)
    seen = z + noise * rng.standard_normal(z.shape)
    return Surface(X, Y, seen, np.full(z.shape, noise), np.ones(z.shape, bool), **more)  # type: ignore[arg-type]


def test_the_force_is_hertz_force() -> None:
    made = surface(ball(30, 22, 5, 0.1))
    layer = Layer(youngs_modulus_mpa=0.5, youngs_modulus_sigma_mpa=0.0)
    (found,) = contacts(made, regions(made), layer)
    force = 4 / 3 * layer.plane_modulus * 250**0.5 * 0.1**1.5
    assert found.force == pytest.approx(force, rel=0.02)
    assert found.force_sigma is not None
    assert found.force_sigma < 0.02 * force
    assert re.match(r"depth 0\.100\d+ ± .* mm, x .* mm², .* mm³, .*force 0\.44\d+ ± .* N, ", str(found))


@pytest.mark.parametrize("sides", [(3.0, 3.0), (8.0, 2.0), (15.0, 1.5)])
def test_the_force_of_a_long_contact_is_that_which_presses(sides: tuple[float, float]) -> None:
    """A half-space under pressure on an ellipse: the sum of Boussinesq's deflections p dA / (pi E* r)."""
    layer, step = Layer(youngs_modulus_mpa=0.5, youngs_modulus_sigma_mpa=0.0), 0.1
    x, y = np.meshgrid(np.arange(-120, 120, step), np.arange(-90, 90, step))
    pressure = 0.01 * np.sqrt(np.maximum(1 - (x / sides[0]) ** 2 - (y / sides[1]) ** 2, 0))
    away = np.hypot(x, y)
    at_zero = 4 * np.arcsinh(1) / step  # mean of 1 / r over a square around
    kernel = np.fft.ifftshift(np.where(away < step / 2, at_zero, 1 / np.maximum(away, step / 2)))
    whole = np.fft.irfft2(np.fft.rfft2(pressure) * np.fft.rfft2(kernel), pressure.shape)
    sunk = whole * step**2 / (np.pi * layer.plane_modulus)
    spline = scipy.interpolate.RectBivariateSpline(y[:, 0], x[0], sunk)
    made = surface(spline.ev(Y - 22, X - 30))
    (found,) = contacts(made, regions(made), layer)
    assert found.force == pytest.approx(pressure.sum() * step**2, rel=0.02)


@pytest.mark.parametrize(
    "presses", [[(30, 22, 5, 0.1)], [(15, 12, 3, 0.06), (40, 30, 4, 0.08)], [(52, 22, 4, 0.1)]]
)
def test_sag_is_found_and_taken_off(presses: list[tuple[float, float, float, float]]) -> None:
    """The edge x = 60 counts as at rest: the free mode brings it to zero there on average."""
    z, free = sum(ball(*press) for press in presses), X / 60 + 0.2
    sunk = float(z[:, -1].mean())
    made = surface(z - sunk / 1.2 * free, free=free)
    found = load_fit(made, None)
    assert found is not None
    assert found.c == pytest.approx(-sunk / 1.2, abs=4 * found.sigma)
    assert found.sigma < 0.06 * sunk
    off = made.less(found).z - z
    assert np.sqrt(np.mean(off**2)) < 0.05 * sunk


def base(radius: float, depth: float, thickness: float, nu: float) -> scipy.interpolate.CubicSpline:
    """What a rigid base adds to `ball`, by distance: waves of Airy's stress f =
    (A + B z) e^-z + (C + D z) e^z in plane strain, f = 1 and f' = 0 where it presses; nothing moves at depth
    q = k h."""

    def terms(z: np.ndarray, order: int) -> np.ndarray:
        down, up = (-1) ** order * np.exp(-z), np.exp(z)
        return np.stack([down, (z - order) * down, up, (z + order) * up], axis=-1)

    step = 16 / thickness / 2000
    k = step * (np.arange(2000) + 0.5)
    q = k * thickness
    still = (1 - nu) * terms(q, 2) + nu * terms(q, 0), (1 - nu) * terms(q, 3) - (2 - nu) * terms(q, 1)
    equations = np.stack([terms(0 * q, 0), terms(0 * q, 1), *still], axis=1)
    stress = np.linalg.solve(equations, np.eye(4)[:, :1])
    ratio = (terms(0 * q, 3) * stress[..., 0]).sum(axis=1) / 2  # over the deflection of a half-space
    load = (np.sin(k * radius) - k * radius * np.cos(k * radius)) / (k * radius) ** 3
    r = np.linspace(0, 60, 400)
    added = scipy.special.j0(np.outer(r, k)) @ ((ratio - 1) * load) * step
    return scipy.interpolate.CubicSpline(r, 4 * depth * radius / np.pi * added)


@pytest.mark.parametrize("thickness", [12.0, 20.0])
def test_a_base_behind_the_layer_is_no_sag(thickness: float) -> None:
    free, layer = X / 60 + 0.2, Layer(youngs_modulus_mpa=1.0, poisson=0.48, thickness_mm=thickness)
    z = ball(30, 22, 4, 0.1) + base(4, 0.1, thickness, 0.48)(np.hypot(X - 30, Y - 22))
    made = surface(z - 1e-3 * free, free=free)
    for given in (layer, None):
        found = load_fit(made, given)
        assert found is not None
        assert found.c == pytest.approx(-1e-3, abs=4 * found.sigma)
        assert found.sigma < 1e-4
        assert found.misfit < 1.5


@pytest.mark.parametrize(
    "presses", [[(30, 22, 5, 0.1)], [(16 + 3 * k, 10 + 2.4 * k, 3, 0.02) for k in range(10)]]
)
def test_motion_comes_off_with_the_sag(presses: list[tuple[float, float, float, float]]) -> None:
    """Also under a long contact, whose far field is no round one's."""
    z, free = sum(ball(*press) for press in presses), (X / 60 + 0.3) ** 2
    modes = 1e-3 * np.stack([X / 60, (Y - 22) / 22, (X / 30 - 1) ** 2])
    moved = np.array([1.0, -0.5, 0.7])
    sunk = z - 0.005 * free + np.tensordot(moved, modes, 1)
    made = surface(sunk, free=free, modes=modes, motions=3)
    found = load_fit(made, None)
    assert found is not None
    left = made.less(found)
    total = np.hypot(left.sigma, left.unsettled)
    assert 0.5 < np.sqrt(np.mean(((left.z - z) / total) ** 2)) < 1.2
    assert np.sqrt(np.mean(total**2)) < 3e-4  # of motions and a sag of several um


@pytest.mark.parametrize("thickness", [12.0, 30.0])
def test_a_layer_of_unknown_thickness_is_within_sigma_where_the_rig_moved(thickness: float) -> None:
    """It sinks by more than the noise, which its far field does not show."""
    z = ball(30, 22, 4, 0.06) + base(4, 0.06, thickness, 0.48)(np.hypot(X - 30, Y - 22))
    free = X / 60 + 0.2
    modes = 1e-3 * np.stack([X / 60, (Y - 22) / 22, (X / 30 - 1) ** 2])
    moved = np.tensordot(np.array([1.0, -0.5, 0.7]), modes, 1)
    sunk = z - float(z[:, -1].mean()) / 1.2 * free + moved
    made = surface(sunk, noise=2e-5, free=free, anchors=EDGE, modes=modes, motions=3)
    found = load_fit(made, None)
    assert found is not None
    left = made.less(found)
    error, total = left.z - z, np.hypot(left.sigma, left.unsettled)
    assert 0.5 < np.sqrt(np.mean((error / total) ** 2)) < 1.6
    assert np.sqrt(np.mean(error**2)) < 1.5e-4


@pytest.mark.parametrize(("width", "least"), [(5.0, 0.12), (8.0, 0.08)])
def test_a_dent_that_fades_sinks_nothing(width: float, least: float) -> None:
    """A motion looks like sinking: both are unknown where a load may make the flank."""
    z = 0.3 * np.exp(-((X - 30) ** 2 + (Y - 22) ** 2) / (2 * width**2))
    modes, ratios = 1.7e-3 * np.stack([1 - X / 60, (Y - 22) / 22]), list[float]()
    for seed in range(6):
        moved = np.tensordot(np.random.default_rng(seed).standard_normal(2), modes, 1)
        made = surface(z + moved, noise=1.5e-5, free=X / 60 + 0.2, anchors=EDGE, modes=modes, motions=2)
        found = load_fit(made, None)
        assert found is not None
        left = made.less(found)
        total = np.hypot(left.sigma, left.unsettled)
        ratios.append(float(np.mean(((left.z - z) / total) ** 2)))
        assert np.sqrt(np.mean(total**2)) < 2e-4
    assert least < np.sqrt(np.mean(ratios)) < 1.5


def test_more_fields_than_cells_settle_what_the_cells_show() -> None:
    """Twelve ridges of six circles, 577 amplitudes, between 400 cells: such a fit ended in an IndexError."""
    rows, columns = (6, 17, 28, 39), (9, 30, 51)
    ways = [np.hypot(np.maximum(np.abs(X - x) - 4.5, 0), Y - y) for x in columns for y in rows]
    away, free = np.min(ways, axis=0), X / 60 + 0.2
    z = 0.05 * np.exp(-((away / 0.6) ** 2) / 2)
    made = replace(surface(z - 0.02 * free, free=free), good=away < 2.2)
    found = load_fit(made, None)
    assert found is not None
    assert found.c == pytest.approx(-0.02, abs=4 * found.sigma)
    assert found.sigma < 0.003


def test_a_tilted_mirror_that_nothing_touches_has_no_contact() -> None:
    modes = 2e-3 * np.stack([X / 60, (Y - 22) / 22])
    made = surface(np.tensordot([1.0, 1.0], modes, 1), free=X / 60 + 0.2, modes=modes, motions=2)
    found = load_fit(made, None)
    assert found is not None
    assert regions(made.less(found)) == ()


def test_one_object_is_one_contact_and_two_are_two() -> None:
    q = np.maximum(np.hypot(X - 30, Y - 22) / 6, 1.0)
    punch = surface(0.05 * 2 / np.pi * np.arcsin(1 / q), noise=5e-4)
    assert len(regions(punch)) == 1
    assert len(regions(surface(ball(20, 22, 4, 0.1) + ball(36, 22, 3, 0.03)))) == 2


@pytest.mark.parametrize("end", [24, 26, 28, 30])
def test_a_dent_cut_before_its_tip_is_at_least_so_deep(end: float) -> None:
    """Unknown cells from x = end on, as far as the map goes; the tip is at x = 30."""
    made = surface(ball(30, 22, 6, 0.1))
    good = end > X
    seen = Surface(X, Y, np.where(good, made.z, np.nan), made.sigma, good)
    (found,) = contacts(seen, regions(seen), Layer(youngs_modulus_mpa=0.5))
    assert str(found).startswith("depth at least ")
    assert re.search("area at least .* volume at least .*force at least .* N$", str(found))
    assert found.depth == pytest.approx(made.z[good].max(), abs=2e-4)
