"""Discrete codes: the sawtooth of rounding in the height's sigma; bridged seams."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Flag
from optolever.reconstruct import reconstruct

from .conftest import rms_score, scores

Floats = NDArray[np.float64]


@pytest.mark.daily(2)
@pytest.mark.parametrize(
    ("preset", "dent", "rows", "cols", "between"),
    [
        ("monitor-mirror", "gaussian", 96, 115, 0.0),
        ("monitor-mirror", "gaussian", 96, 115, 0.15),
        ("paper-simulation", "gaussian", 90, 96, 0.0),
        ("paper-simulation", "gaussian", 90, 96, 0.15),
        ("monitor-mirror", "gaussian:peak=0.3", 120, 140, 0.0),  # in step where the map bends
    ],
)
def test_sigma_holds_the_errors_of_cells_in_step_with_pixels(
    exact, preset, dent, rows, cols, between
) -> None:
    """Wherever the cells begin: rounding errors are shared along lines of pixels, or by patches. between:
    how far (px) around the cells' ends both are likely, and a decoder tells the mean of the two."""
    scene, truth, correspondence = exact(preset, dent, rows, cols)
    sigma = np.full(truth.u.shape, 1 / np.sqrt(12))
    found = []
    rng = np.random.default_rng(1)
    for begin in rng.uniform(-0.5, 0.5, (6, 2)):
        # the surface shifted against its cells: coordinates of the same scene, rounded elsewhere
        u, v = (
            _middles(part + shift, between, rng) - shift
            for part, shift in zip((truth.u, truth.v), begin, strict=True)
        )
        shifted = replace(correspondence, u=u, v=v, sigma_u=sigma, sigma_v=sigma.copy())
        pattern = scene.pattern
        moved = pattern.origin - pattern.pitch * (begin[0] * pattern.u_axis + begin[1] * pattern.v_axis)
        rig = replace(scene, pattern=replace(pattern, origin=moved))
        whole = replace(shifted, u=u + begin[0], v=v + begin[1])
        height = reconstruct(whole, rig)
        assert height.good.mean() > 0.98
        found.append(scores(height, truth))
    assert 0.4 < rms_score(*found) < 1.2
    assert np.nanmax(np.abs(found)) < 5


def test_seams_between_cells_do_not_part_the_image(exact, cut) -> None:
    scene, truth, correspondence = exact("monitor-mirror", "gaussian", 96, 115)
    seams = (np.arange(96)[:, None] % 7 == 3) | (np.arange(115) % 8 == 5)
    height = reconstruct(cut(correspondence, ~seams), scene)
    assert height.good[~seams].all()
    assert (height.flags[seams] & Flag.DARK).all()
    assert np.nanmax(np.abs(height.z - truth.z)[~seams]) < 5e-5 * np.nanmax(truth.z)  # cubics over two pixels


def _middles(coord: Floats, between: float, rng: np.random.Generator) -> Floats:
    """Middles of the cells; beside their ends somewhere between two of them."""
    end = np.floor(coord) + 0.5
    unsure = np.abs(coord - end) < between
    return np.where(unsure, end + rng.uniform(-0.5, 0.5, coord.shape), np.rint(coord))
