"""Displacement: its record, its way to a Correspondence, and that nothing takes it for one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import Correspondence, Displacement
from optolever.live import crossed
from optolever.patterns import sequence
from optolever.reconstruct import exact_correspondence, reconstruct, slope_map
from optolever.scene import dent, load, resize, trace

ONE = np.ones((16, 20))


def record(u: float, v: float, sigma: float, flag: int, wrong: float | None = None) -> Correspondence:
    flags = np.zeros(ONE.shape, np.uint16)
    flags[flag] = 1 << flag
    error = None if wrong is None else wrong * ONE
    return Correspondence(u * ONE, v * ONE, sigma * ONE, 2 * sigma * ONE, flags, 50 * ONE, 60 * ONE, error)


def moved_by(u: float, v: float, shape: tuple[int, int] = ONE.shape) -> Displacement:
    one, flags = np.ones(shape), np.zeros(shape, np.uint16)
    flags[1] = 2
    return Displacement(u * one, v * one, 0.3 * one, 0.6 * one, flags, order_error=0.1 * one)


def test_rest_and_displacement_add() -> None:
    """Variances add, flags are or-ed, either order may be wrong."""
    moved, rest = moved_by(2.5, -1.0), record(4.5, 6.0, 0.4, 2, 0.2)
    whole = moved.added_to(rest)
    assert isinstance(whole, Correspondence)
    np.testing.assert_allclose(whole.u, 7.0)
    np.testing.assert_allclose(whole.v, 5.0)
    np.testing.assert_allclose(whole.sigma_u, 0.5)
    np.testing.assert_allclose(whole.sigma_v, 1.0)
    np.testing.assert_array_equal(whole.flags, moved.flags | rest.flags)
    np.testing.assert_allclose(whole.order_error, 1 - 0.9 * 0.8)


def test_its_file_is_no_correspondence(tmp_path: Path) -> None:
    moved = moved_by(2.5, -1.0)
    moved.save(tmp_path / "moved.npz")
    with pytest.raises(InputError, match=r"moved\.npz: field 'u' is missing"):
        Correspondence.load(tmp_path / "moved.npz")
    assert repr(moved) == "Displacement(16 x 20 pixels, 93.8% good, median du +2.5, dv -1 pattern pixels)"


def test_shapes_must_agree() -> None:
    rest = record(1.0, 1.0, 0.1, 0)
    small = Correspondence(*(np.zeros((4, 4)) for _ in range(4)), np.zeros((4, 4), np.uint16))
    with pytest.raises(InputError, match="must be equal"):
        moved_by(0.0, 0.0).added_to(small)
    with pytest.raises(InputError, match="dv has shape"):
        replace(moved_by(0.0, 0.0), dv=np.zeros((3, 3)))
    with pytest.raises(InputError, match="must be integer"):
        replace(moved_by(0.0, 0.0), flags=np.zeros(ONE.shape))
    with pytest.raises(InputError, match="sigma_u has shape"):
        replace(rest, sigma_u=np.zeros((3, 3)))
    with pytest.raises(InputError, match="flags is float64"):
        replace(rest, flags=np.zeros(ONE.shape))


def test_no_solver_and_no_prior_takes_a_displacement() -> None:
    """A flat mirror's displacements are 0 everywhere: as a correspondence they are a mirror of 21 mm."""
    scene = resize(load("paper-simulation", exact=True), 40, 48)
    flat = trace(scene, dent("flat", scene))
    rest = exact_correspondence(flat)
    moved = moved_by(0.0, 0.0, flat.u.shape)
    for call in (
        lambda: reconstruct(moved, scene),  # type: ignore[arg-type]
        lambda: reconstruct(rest, scene, rest=moved),  # type: ignore[arg-type]
        lambda: slope_map(reconstruct(rest, scene), moved, scene),  # type: ignore[arg-type]
    ):
        with pytest.raises(InputError, match=r"Displacement, must be .* displacement\.added_to"):
            call()
    height = reconstruct(moved.added_to(rest), scene)
    assert np.abs(height.z[height.good]).max() < 1e-2
    image = np.zeros(flat.u.shape, np.uint8)
    with pytest.raises(InputError, match="prior: Displacement, must be"):
        crossed(image, image, sequence("crossed", 40, 48), prior=moved)  # type: ignore[arg-type]
