"""Response of display and camera: given, tabled, measured."""

from collections.abc import Callable

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import Response, decode
from optolever.patterns import sequence

from .conftest import Map, Shoot, silent


def test_gamma_is_inverted() -> None:
    response = Response.from_gamma(2.2)
    shown = np.linspace(0, 255, 60)
    np.testing.assert_allclose(response.shown_of(255 * (shown / 255) ** 2.2), shown, atol=0.6)


def test_table_in_any_order_with_a_dead_end() -> None:
    """Entries where the camera no longer tells levels apart are left out."""
    response = Response.from_table([255, 0, 100, 200, 220], [230, 2, 90, 230, 228])
    np.testing.assert_array_equal(response.shown, [0, 100, 200])
    assert response.shown_of(46.0) == pytest.approx(50)
    assert response.shown_of(2.0 - 0.88) == pytest.approx(-0.88 * 200 / 228)


@pytest.mark.daily(1)
@pytest.mark.parametrize(("name", "params"), [("stripe", {"step": 8}), ("micro-phase", {})])
def test_grey_values_and_sweeps_are_inverted_too(
    shoot: Shoot, smooth: Map, name: str, params: dict[str, float]
) -> None:
    """Gamma 2.2, no blur: flagged or in sigma as it is, decoded within a smaller one by the response."""
    shown = sequence(name, 150, 170, **params)
    frames = shoot(shown, *smooth, gamma=2.2, noise=0.5, offset=127.5, amplitude=120)
    response = Response.from_gamma(2.2, blur=0.0)
    bent, straight = (decode(frames, shown, response=given) for given in (None, response))
    assert silent(bent, *smooth) == 0
    assert bent.good.mean() < 0.1 or np.median(bent.sigma_u) > 2 * np.median(straight.sigma_u)
    assert straight.good.mean() > 0.9
    error = ((straight.u - smooth[0]) / straight.sigma_u)[straight.good]
    assert 0.5 < np.sqrt(np.mean(error**2)) < 1.2


@pytest.mark.daily(2)
@pytest.mark.parametrize(
    ("name", "params", "worst"),
    [("gray", {}, 0.6), ("gray", {"inverses": False}, 0.6), ("gray+phase", {}, 0.1)],
)
@pytest.mark.parametrize("curve", [1.0, 2.2])
def test_bits_are_inverted_too(
    shoot: Shoot, smooth: Map, name: str, params: dict[str, bool], worst: float, curve: float
) -> None:
    """Places as a linear camera tells them; a straight response changes none of them."""
    shown = sequence(name, 150, 170, **params)
    frames = shoot(shown, *smooth, gamma=curve, noise=0.5, offset=127.5, amplitude=120)
    found = decode(frames, shown, response=Response.from_gamma(curve), on_cells=False)
    assert found.good.mean() > 0.9
    for place, truth in zip((found.u, found.v), smooth, strict=True):
        assert np.abs(place - truth)[found.good].max() < worst
    if curve == 1:
        plain = decode(frames, shown, on_cells=False)
        np.testing.assert_array_equal(plain.good, found.good)
        np.testing.assert_allclose(found.u[found.good], plain.u[found.good], atol=0.02)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Response(np.array([0.0, 1.0]), np.array([1.0, 1.0])), "seen must be finite and rise"),
        (lambda: Response(np.array([0.0]), np.array([1.0])), "shape"),
        (lambda: Response.from_table([0, np.nan], [1, 2]), "not finite"),
        (lambda: Response.from_gamma(0.0), "gamma is 0.0"),
        (lambda: Response.from_ramp(np.zeros((1, 4, 4)), sequence("lattice", 8, 8)), "shows 0 levels"),
        (
            lambda: decode(
                np.zeros((22, 4, 4)), sequence("gray+phase", 150, 170), response=Response.from_gamma(2)
            ),
            "float32",
        ),
    ],
)
def test_bad_input(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.daily(1)
@pytest.mark.parametrize("steps", [3, 4, 5])
def test_no_harmonic_is_left_by_the_right_gamma(shoot: Shoot, smooth: Map, steps: int) -> None:
    shown = sequence("gray+phase", 150, 170, steps=steps, axes="u")
    light = np.full((120, 140), 30000.0)
    seen = shoot(shown, *smooth, gamma=2.2, dtype=np.uint16, offset=light, amplitude=light)
    found = decode(seen, shown, response=Response.from_gamma(2.2, 60000.0), on_cells=False)
    assert np.sqrt(np.mean((found.u - smooth[0]) ** 2)) < 1e-3
