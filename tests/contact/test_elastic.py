"""Figures of contacts from the elastic field around them, against closed forms that the fit does not use."""

import numpy as np
import pytest
import scipy.ndimage

from optolever.contact import Surface, elastic_fits, far_field, regions
from optolever.scene import Layer

from .test_contact import X, Y, ball, base, surface


def smooth(z: np.ndarray, seed: int, noise: float = 5e-5) -> Surface:
    """With noise as of integrated slopes: about 40 samples of it are independent."""
    grain = scipy.ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(z.shape), 6.0)
    seen = z + noise * grain / grain.std()
    return Surface(X, Y, seen, np.full(z.shape, noise), np.ones(z.shape, bool))


def around(made: Surface, hidden: np.ndarray) -> Surface:
    return Surface(X, Y, made.z, made.sigma, made.good & ~hidden, modes=made.modes, motions=made.motions)


@pytest.mark.parametrize(("x", "hidden"), [(30.0, 0.0), (30.0, 4.5), (58.0, 0.0), (2.0, 0.0)])
def test_a_ball_is_found_where_its_inside_is_dark_or_cut(x: float, hidden: float) -> None:
    """Hertz: F / E* = 4 / 3 a d; a dark inside costs the depth its sigma, not the force."""
    ratios = []
    for seed in range(6):
        made = smooth(ball(x, 22, 4.5, 0.1), seed)
        made = around(made, np.hypot(X - x, Y - 22) < hidden)
        (found,) = elastic_fits(made, regions(made), None)
        assert found is not None
        assert found.values[4] == pytest.approx(0.6, abs=4 * found.sigmas[4])
        assert found.sigmas[4] < 0.005 * 0.6
        assert abs(found.values[3] - 0.1) < 2.5 * found.sigmas[3] < 0.03
        ratios.append((found.values[:3] - (x, 22, 4.5)) / found.sigmas[:3])
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 1.3


def test_a_dent_that_fades_is_no_such_contact() -> None:
    for width in (2.0, 4.0):
        made = surface(0.1 * np.exp(-((X - 30) ** 2 + (Y - 22) ** 2) / (2 * width**2)))
        for layer in (None, Layer(0.5, thickness_mm=15.0)):
            assert elastic_fits(made, regions(made), layer) == [None]


def test_a_mirror_that_rises_around_a_dent_is_no_such_contact() -> None:
    """Its load would be negative, and its slope is zero in the middle: no warning of a division."""
    dent = surface(ball(30, 22, 4.5, 0.1))
    assert elastic_fits(surface(-dent.z), regions(dent), None) == [None]


@pytest.mark.parametrize("thickness", [14.0, 24.0])
def test_the_thickness_of_a_layer_is_found(thickness: float) -> None:
    """By waves of Airy's stress (`base`), on which the anchor's sinking is free."""
    z = ball(30, 22, 4, 0.1) + base(4, 0.1, thickness, 0.48)(np.hypot(X - 30, Y - 22))
    made = surface(z - 2e-4 * (X / 60 + 0.2), modes=1e-3 * (X / 60 + 0.2)[None], motions=1)
    for layer in (Layer(0.5, 0.48, thickness), Layer(0.5, 0.48)):
        (found,) = elastic_fits(made, regions(made), layer)
        assert found is not None
        assert found.whole
        assert found.values[4] == pytest.approx(4 / 3 * 4 * 0.1, rel=0.03)
        assert abs(found.values[4] - 4 / 3 * 4 * 0.1) < 4 * found.sigmas[4]
        if layer.thickness_mm is None:
            assert found.thickness == pytest.approx(thickness, rel=0.1)


def test_a_contact_that_leaves_no_cell_outside_has_an_empty_far_field() -> None:
    """As of a frame in which a dent hides the mirror: four fields of no place."""
    nowhere = np.empty(0)
    assert far_field(None, [(10.0, 10.0, 5.0)], nowhere, nowhere).shape == (4, 0)
