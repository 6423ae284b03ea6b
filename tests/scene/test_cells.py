"""Cells that are not square: a DMD's, or an anamorphic video mode's."""

from dataclasses import replace

import numpy as np

from optolever.decode import decode
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.reconstruct import reconstruct
from optolever.scene import Pattern, dent, load, resize


def test_places_are_steps_along_either_axis() -> None:
    pattern = Pattern((1, 2, 3), (0, 1, 0), (0.6, 0, 0.8), 0.2, 40, 30, aspect=0.7)
    u, v = np.array([3.0, 11.5]), np.array([7.25, 20.0])
    points = np.array([1, 2, 3]) + 0.2 * u[:, None] * [0, 1, 0] + 0.14 * v[:, None] * [0.6, 0, 0.8]
    np.testing.assert_allclose(pattern.point(u, v), points, atol=1e-12)
    np.testing.assert_allclose(pattern.coordinates(points), [u, v], atol=1e-12)
    toward = np.tile(pattern.normal[:, None], 2)
    np.testing.assert_allclose(pattern.landing(points.T - 5 * toward, toward)[:2], [u, v], atol=1e-12)


def test_heights_through_cells_that_are_not_square() -> None:
    """Half as tall, in twice as many rows; by photon noise, about 2 levels."""
    scene = resize(load("prism48", exact=True), 80, 100)
    scene = replace(scene, pattern=replace(scene.pattern, aspect=0.5, rows=2 * scene.pattern.rows))
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    seen = capture(scene, dent("gaussian", scene, peak=0.1, sigma=5), shown, noise=0.5)
    height = reconstruct(decode(seen.frames, shown), scene)
    z = dent("gaussian", scene, peak=0.1, sigma=5).height(height.x, height.y)
    assert height.good.mean() > 0.9
    error = (height.z - z)[height.good]
    assert np.sqrt(np.mean(error**2)) < 4e-4
    assert np.sqrt(np.mean(np.square(error / height.sigma[height.good]))) < 1.3
