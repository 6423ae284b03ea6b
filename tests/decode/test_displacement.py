"""Displacement: its record, its way to a Correspondence, and that nothing takes it for one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import Correspondence, Displacement, difference
from optolever.live import crossed, lattice
from optolever.patterns import sequence
from optolever.reconstruct import exact_correspondence, reconstruct, slope_map
from optolever.scene import dent, load, resize, trace

ONE = np.ones((16, 20))


def record(u: float, v: float, sigma: float, flag: int, wrong: float | None = None) -> Correspondence:
    flags = np.zeros(ONE.shape, np.uint16)
    flags[flag] = 1 << flag
    error = None if wrong is None else wrong * ONE
    return Correspondence(u * ONE, v * ONE, sigma * ONE, 2 * sigma * ONE, flags, 50 * ONE, 60 * ONE, error)


def test_difference_and_sum() -> None:
    """rest + (deformed - rest) is deformed; variances add each time, flags are or-ed, either order wrong."""
    deformed, rest = record(7.0, 5.0, 0.3, 1, 0.1), record(4.5, 6.0, 0.4, 2, 0.2)
    moved = difference(deformed, rest)
    assert isinstance(moved, Displacement)
    np.testing.assert_allclose(moved.du, 2.5)
    np.testing.assert_allclose(moved.dv, -1.0)
    np.testing.assert_allclose(moved.sigma_u, 0.5)
    np.testing.assert_allclose(moved.sigma_v, 1.0)
    np.testing.assert_array_equal(moved.flags, deformed.flags | rest.flags)
    np.testing.assert_allclose(moved.order_error, 1 - 0.9 * 0.8)
    whole = moved.added_to(replace(rest, order_error=None))
    assert isinstance(whole, Correspondence)
    np.testing.assert_allclose(whole.u, deformed.u)
    np.testing.assert_allclose(whole.v, deformed.v)
    np.testing.assert_allclose(whole.sigma_u**2, 0.5**2 + 0.4**2)
    np.testing.assert_array_equal(whole.flags, moved.flags)
    np.testing.assert_allclose(whole.order_error, 1 - 0.9 * 0.8)


def test_its_file_is_no_correspondence(tmp_path: Path) -> None:
    moved = difference(record(7.0, 5.0, 0.3, 1), record(4.5, 6.0, 0.4, 2))
    moved.save(tmp_path / "moved.npz")
    with pytest.raises(InputError, match=r"moved\.npz: field 'u' is missing"):
        Correspondence.load(tmp_path / "moved.npz")
    assert repr(moved) == "Displacement(16 x 20 pixels, 87.5% good, median du +2.5, dv -1 pattern pixels)"


def test_shapes_must_agree() -> None:
    rest = record(1.0, 1.0, 0.1, 0)
    small = Correspondence(*(np.zeros((4, 4)) for _ in range(4)), np.zeros((4, 4), np.uint16))
    for call in (lambda: difference(rest, small), lambda: difference(rest, rest).added_to(small)):
        with pytest.raises(InputError, match="must be equal"):
            call()
    with pytest.raises(InputError, match="dv has shape"):
        replace(difference(rest, rest), dv=np.zeros((3, 3)))
    with pytest.raises(InputError, match="must be integer"):
        replace(difference(rest, rest), flags=np.zeros(ONE.shape))
    with pytest.raises(InputError, match="sigma_u has shape"):
        replace(rest, sigma_u=np.zeros((3, 3)))
    with pytest.raises(InputError, match="flags is float64"):
        replace(rest, flags=np.zeros(ONE.shape))


def test_no_solver_and_no_prior_takes_a_displacement() -> None:
    """A flat mirror's displacements are 0 everywhere: as a correspondence they are a mirror of 21 mm."""
    scene = resize(load("paper-simulation", exact=True), 40, 48)
    flat = trace(scene, dent("flat", scene))
    rest = exact_correspondence(flat)
    moved = difference(rest, rest)
    for call in (
        lambda: reconstruct(moved, scene),  # type: ignore[arg-type]
        lambda: reconstruct(rest, scene, rest=moved),  # type: ignore[arg-type]
        lambda: slope_map(reconstruct(rest, scene), moved, scene),  # type: ignore[arg-type]
    ):
        with pytest.raises(InputError, match=r"Displacement, must be .* displacement\.added_to"):
            call()
    height = reconstruct(moved.added_to(rest), scene)
    assert np.abs(height.z[height.good]).max() < 1e-2
    for name, follow in (("crossed", crossed), ("lattice", lattice)):
        image = np.zeros(flat.u.shape, np.uint8)
        with pytest.raises(InputError, match="prior: Displacement, must be"):
            follow(image, image, sequence(name, 40, 48), prior=moved)  # type: ignore[operator]
