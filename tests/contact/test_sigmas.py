"""Sigmas of contacts agree with their errors, from both sides; forces behind a layer."""

import numpy as np
import pytest

from lab.figures import pressed
from optolever.contact import Surface, contacts, elastic_fits, load_fit, regions
from optolever.scene import Layer

from .test_contact import X, Y, ball, surface
from .test_elastic import around, smooth


def ratio(errors: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def test_a_tip_between_cells_is_in_the_sigmas_of_depth_and_area() -> None:
    """A cone's tip, anywhere in a cell: half of a higher tip lies farther inside."""
    deep, wide = list[float](), list[float]()
    for seed in range(40):
        x, y = np.random.default_rng(seed).uniform(-0.19, 0.19, 2)
        made = surface(np.maximum(0.06 * (1 - np.hypot(X - 30 - x, Y - 22 - y) / 5), 0), noise=1e-6)
        (found,) = contacts(made, regions(made), None)
        deep.append((found.depth - 0.06) / found.depth_sigma)
        wide.append((found.area - np.pi * 2.5**2) / found.area_sigma)
    assert 0.3 < ratio(deep) < 1.3
    assert 0.3 < ratio(wide) < 1.3


@pytest.mark.parametrize("amount", [0.1, 0.5, 2.5])
def test_what_the_motion_shows_of_the_rig_is_in_sigma(amount: float) -> None:
    """An error of the rig scales the dent by 5 % and looks like motion: how much of it there is, the motion
    says (Bayes' rule)."""
    tilt, dent = (Y - 22) / 22, ball(30, 22, 4, 0.1)
    modes = np.stack([0.05 * dent + 4e-3 * tilt, 1e-4 * X / 60, 1e-4 * tilt])
    made = surface(dent + amount * modes[0], noise=2e-5, free=X / 60 + 0.2, modes=modes, motions=2)
    found = load_fit(made, None)
    assert found is not None
    left = made.less(found)
    assert left.modes is not None
    middle = np.hypot(X - 30, Y - 22) < 2
    sigma = np.sqrt(np.square(left.modes).sum(axis=0) + np.square(left.sigma))
    assert 0.3 < ratio(((left.z - dent) / sigma)[middle].tolist()) < 1.3


@pytest.mark.parametrize(("poisson", "thickness"), [(0.48, 12.0), (0.3, 20.0), (0.48, 400.0)])
def test_the_force_behind_a_layer_is_that_which_presses(poisson: float, thickness: float) -> None:
    """By squares and by the fit, on waves of Airy's stress; of a thick one it is a half-space's."""
    layer = Layer(0.5, poisson, thickness, 0.0)
    one = pressed.on_layer(4.0, 0.1, thickness, poisson)
    made = surface(one.height(np.hypot(X - 30, Y - 22).ravel()).reshape(X.shape))
    found = regions(made)
    for fits in ((), elastic_fits(made, found, layer)):
        (contact,) = contacts(made, found, layer, fits)
        assert contact.force == pytest.approx(layer.plane_modulus * one.load, rel=0.03)


def test_a_thin_layer_is_a_bed_of_springs() -> None:
    """K. L. Johnson, Contact Mechanics, eq. 5.67: p = E (1 - nu) z / (h (1 + nu) (1 - 2 nu))."""
    layer, nu = Layer(0.5, 0.3, 0.5, 0.0), 0.3
    z = 0.02 * np.maximum(1 - (np.hypot(X - 30, Y - 22) / 10) ** 2, 0)
    made = surface(z, noise=2e-6)
    (found,) = contacts(made, regions(made), layer)
    spring = 0.5 * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / 0.5
    whole = spring * float(z.sum()) * (X[0, 1] - X[0, 0]) * (Y[1, 0] - Y[0, 0])
    assert found.force == pytest.approx(whole, rel=0.1)


def test_a_rounded_punch_is_a_sum_of_flat_ones() -> None:
    """Its force, and its plateau to 8 %: the deepest cells lie on the rim."""
    forces, depths = list[float](), list[float]()
    one = pressed.rounded_punch(4.0, 0.08, 0.6)
    for seed in range(8):
        made: Surface = smooth(one.height(np.hypot(X - 30, Y - 22).ravel()).reshape(X.shape), seed, 2e-4)
        found = regions(made)
        layer = Layer(0.5, youngs_modulus_sigma_mpa=0.0)
        (contact,) = contacts(made, found, layer, elastic_fits(made, found, layer))
        assert contact.force is not None
        assert contact.force_sigma is not None
        forces.append((contact.force - layer.plane_modulus * one.load) / contact.force_sigma)
        depths.append((contact.depth - one.depth) / contact.depth_sigma)
        assert contact.depth_sigma < 0.08 * one.depth
        assert contact.force_sigma < 0.03 * contact.force
    assert 0.3 < ratio(forces) < 1.3
    assert max(map(abs, depths)) < 3


def test_few_cells_are_a_contact_where_they_are_sure() -> None:
    """Eight cells deeper than half: beyond eight sigma they are one, below twelve cells at seven none."""
    z = 0.02 * np.exp2(-((X - 30) ** 2 + (Y - 22) ** 2) / 0.6**2)
    assert 5 <= np.count_nonzero(z > 0.01) < 12
    for noise, count in ((0.02 / 40, 1), (0.02 / 7.5, 0)):
        made = Surface(X, Y, z, np.full(z.shape, noise), np.ones(z.shape, bool))
        assert len(regions(made)) == count


@pytest.mark.parametrize(("x", "hidden"), [(30.0, 4.5), (30.0, 2.0), (60.0, 0.0), (2.0, 0.0), (30.0, -28.0)])
def test_place_and_area_of_what_is_not_measured_are_those_of_the_field(x: float, hidden: float) -> None:
    """Hertz: half of the depth lies at the ball's contact radius. Dark inside, cut by the map's ends, by
    unknown cells beyond the tip. Area of the map: -70 to -100 % of it, or a hole's."""
    layer, ratios = Layer(0.5, youngs_modulus_sigma_mpa=0.0), list[tuple[float, ...]]()
    for seed in range(6):
        made = smooth(ball(x, 22, 4.5, 0.1), seed)
        made = around(made, np.hypot(X - x, Y - 22) < hidden if hidden >= 0 else -hidden < X)
        found = regions(made)
        (contact,) = contacts(made, found, layer, elastic_fits(made, found, layer))
        area, most = np.pi * 4.5**2, 1.5 * 4 / 3 * 0.45 * layer.plane_modulus / (np.pi * 4.5**2)
        assert not contact.force_at_least
        assert contact.area_sigma < 0.3 * area
        assert contact.pressure == pytest.approx(most, rel=0.35)
        off = contact.x - x, contact.y - 22, contact.area - area, contact.volume - 0.075 * area
        sigmas = contact.position_sigma, contact.position_sigma, contact.area_sigma, contact.volume_sigma
        ratios.append(tuple(np.divide(off, sigmas)))
    for each in zip(*ratios, strict=True):
        assert 0.1 < ratio(list(each)) < 1.6


def test_a_flagged_tip_is_at_least_as_deep_as_its_neighbours() -> None:
    """A few cells: the depth of those around, a lower bound; of many what the field around says."""
    layer, deep = Layer(0.5), 0.1 * np.exp2(-((X - 30) ** 2 + (Y - 22) ** 2) / 20)
    for z, size, least in (
        (ball(30, 22, 5, 0.1), 0.6, True),
        (deep, 0.6, True),
        (ball(30, 22, 5, 0.1), 3, False),
    ):
        made = surface(z)
        flagged = around(made, np.hypot(X - 30, Y - 22) < size)
        found = regions(flagged)
        (contact,) = contacts(flagged, found, layer, elastic_fits(flagged, found, layer))
        assert contact.depth_at_least == least
        assert contact.depth == pytest.approx(0.1, rel=0.02)
        assert contact.depth - 0.1 < 3 * contact.depth_sigma < 0.05


def test_a_small_false_dent_leaves_the_other_contacts_their_fits() -> None:
    """A dent that fades, on the flank: its misfit counted for all contacts, and none had a fit."""
    for x, depth in ((50, 0.012), (54, 0.02)):
        small = depth * np.exp2(-((X - x) ** 2 + (Y - 30) ** 2) / 4)
        made = smooth(ball(30, 22, 4.5, 0.1) + small, 0)
        fit, other = elastic_fits(made, regions(made), None)
        assert other is None
        assert fit is not None
        assert abs(fit.values[4] - 0.6) < 4 * fit.sigmas[4] < 0.1
