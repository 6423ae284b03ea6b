"""Variances of slopes where noise is large; small noise is test_exact_sigma's, the slopes test_coupled's."""

import numpy as np
import pytest

from optolever.reconstruct.geometry import pattern_plane, ray_field
from optolever.reconstruct.measured import Measured
from optolever.scene import dent_from_text as dent
from optolever.scene import load, resize, trace

SIZE = 24


def test_variances_where_noise_is_not_small_beside_the_way_to_the_pattern() -> None:
    """Drawn noise, at pixels whose pattern is a few of its standard deviations away; and the variance hardly
    depends on where the noise put the measured point.
    """
    scene = resize(load("paper-simulation", exact=True), SIZE, SIZE)
    rays, plane = ray_field(scene.camera), pattern_plane(scene)
    truth = trace(scene, dent("flat", scene))
    w = -rays.inner_origins[2] / rays.inner_directions[2]
    away = np.linalg.norm(
        np.moveaxis(plane[0] + truth.u[..., None] * plane[1] + truth.v[..., None] * plane[2], -1, 0)
        - rays.inner_origins
        - w * rays.inner_directions,
        axis=0,
    )
    col = int(np.argmin(np.abs(away[SIZE // 2] / np.linalg.norm(plane[1]) - 4.0)))
    sigma = np.full(truth.u.shape, 1.0)
    drawn, told = [], []
    rng = np.random.default_rng(1)
    for _ in range(400):
        u, v = (part + rng.standard_normal(part.shape) for part in (truth.u, truth.v))
        measured = Measured(rays, plane, u, v, sigma, sigma, truth.visible)
        drawn.append(measured.slopes(w)[0][2:-2, col])
        told.append(measured.variances(w)[0][2:-2, col])
    exact, stated = np.var(drawn, axis=0).mean(), np.mean(told)
    assert stated == pytest.approx(exact, rel=0.15)
    assert np.std(told) < 0.35 * stated
