"""The closed forms against SOLVER.md's prism formulas, central differences, and a plane seen by a pinhole."""

import numpy as np
import pytest

from optolever.reconstruct.equations import slope_variances, slopes
from optolever.reconstruct.geometry import PAD, RayField, pattern_plane, ray_field
from optolever.scene import PinholeCamera, load, resize, trace
from optolever.scene import dent_from_text as dent

SIZE = 24


@pytest.fixture(scope="module")
def prism() -> tuple[RayField, np.ndarray, np.ndarray]:
    """Rays and pattern of the 45 degree prism, and a depth from the capture face,
    all in camera coordinates.
    """
    scene = resize(load("paper-simulation"), SIZE, SIZE)
    rays = ray_field(scene.camera)
    row, col = np.mgrid[:SIZE, :SIZE].astype(float)
    s, y = (col + 0.5) * scene.camera.pitch[0], (row + 0.5) * scene.camera.pitch[1]
    return rays, pattern_plane(scene), np.stack([s, y, s + 0.6 * np.sin(s / 30) * np.cos(y / 40)])


def test_prism_formulas(prism: tuple[RayField, np.ndarray, np.ndarray]) -> None:
    """b = (Y - y)/(S - s), a = (D - lambda)/(S - s), r = sqrt(a^2 + 1 + b^2): p = (a + r)/(1 + b^2),
    q = b p.
    """
    rays, plane, (s, y, depth) = prism
    step = rays.inner_origins[:, 0, 1] - rays.inner_origins[:, 0, 0]
    ds, dy = np.linalg.norm(step), y[1, 0] - y[0, 0]
    span = load("paper-simulation").mirror.length / np.sqrt(2)
    rng = np.random.default_rng(0)
    across, along = depth + 5 * rng.standard_normal(s.shape), y + 5 * rng.standard_normal(s.shape)
    pitch = np.linalg.norm(plane[1])
    # The pattern's u axis runs up from P0; depth from the capture face is measured against it.
    u = (span - across) / pitch - 0.5
    v = along / pitch - 0.5
    p, q, p_w, q_w = slopes(rays, plane, u, v, depth)
    a, b = (across - depth) / (span - s), (along - y) / (span - s)
    r = np.sqrt(a**2 + 1 + b**2)
    np.testing.assert_allclose(p, ds * (a + r) / (1 + b**2), rtol=1e-11)
    np.testing.assert_allclose(q, dy * b * (a + r) / (1 + b**2), rtol=1e-11, atol=1e-13)
    slope = -(1 + a / r) / ((1 + b**2) * (span - s))
    np.testing.assert_allclose(p_w, ds * slope, rtol=1e-10)
    np.testing.assert_allclose(q_w, dy * b * slope, rtol=1e-10, atol=1e-13)


CASES = ["paper-simulation", "prism48", "monitor-mirror"]


@pytest.mark.parametrize("preset", CASES)
def test_derivatives_by_central_differences(preset: str) -> None:
    scene = resize(load(preset), SIZE, SIZE)
    rays, plane = ray_field(scene.camera), pattern_plane(scene)
    truth = trace(scene, dent("flat", scene))
    u, v = (np.where(truth.visible, value, 100.0) for value in (truth.u, truth.v))
    distance = -rays.inner_origins[2] / rays.inner_directions[2]
    w = np.log(distance) if rays.logarithmic else distance
    h = 1e-5
    p_w, q_w = slopes(rays, plane, u, v, w)[2:]
    ahead, behind = (slopes(rays, plane, u, v, w + sign * h)[:2] for sign in (1, -1))
    scale = np.abs(p_w).max()
    for exact, plus, minus in zip((p_w, q_w), ahead, behind, strict=True):
        np.testing.assert_allclose(exact, (plus - minus) / (2 * h), rtol=2e-5, atol=1e-5 * scale)
    sigma_u, sigma_v = np.full(u.shape, 3e-4), np.full(u.shape, 1e-4)
    variances = slope_variances(rays, plane, u, v, sigma_u, sigma_v, w)
    for k, variance in enumerate(variances):
        by_u = slopes(rays, plane, u + h, v, w)[k] - slopes(rays, plane, u - h, v, w)[k]
        by_v = slopes(rays, plane, u, v + h, w)[k] - slopes(rays, plane, u, v - h, w)[k]
        expected = (3e-4 * by_u / (2 * h)) ** 2 + (1e-4 * by_v / (2 * h)) ** 2
        np.testing.assert_allclose(variance, expected, rtol=1e-4, atol=1e-6 * expected.max())


def test_variances_where_noise_is_not_small_beside_the_way_to_the_pattern() -> None:
    """Drawn noise, at pixels whose pattern is a few of its standard deviations away; and the variance hardly
    depends on where the noise put the measured point.
    """
    scene = resize(load("paper-simulation"), SIZE, SIZE)
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
        drawn.append(slopes(rays, plane, u, v, w)[0][2:-2, col])
        told.append(slope_variances(rays, plane, u, v, sigma, sigma, w)[0][2:-2, col])
    exact, stated = np.var(drawn, axis=0).mean(), np.mean(told)
    assert stated == pytest.approx(exact, rel=0.15)
    assert np.std(told) < 0.35 * stated


@pytest.mark.parametrize("preset", CASES)
def test_slopes_of_the_mirror_at_rest(preset: str) -> None:
    """Traced correspondences of a flat mirror give back the differences of its distance."""
    scene = resize(load(preset), SIZE, SIZE)
    rays = ray_field(scene.camera)
    truth = trace(scene, dent("flat", scene))
    o, d = rays.origins, rays.directions
    padded = -o[2] / d[2]
    w = np.log(padded) if rays.logarithmic else padded
    along_cols = (8 * (w[2:-2, 3:-1] - w[2:-2, 1:-3]) - (w[2:-2, 4:] - w[2:-2, :-4])) / 12
    along_rows = (8 * (w[3:-1, 2:-2] - w[1:-3, 2:-2]) - (w[4:, 2:-2] - w[:-4, 2:-2])) / 12
    p, q = slopes(rays, pattern_plane(scene), truth.u, truth.v, w[PAD:-PAD, PAD:-PAD].copy())[:2]
    good = truth.visible
    assert good.mean() > 0.5
    scale = np.abs(along_cols).max()
    np.testing.assert_allclose(p[good], along_cols[good], atol=3e-5 * scale)
    np.testing.assert_allclose(q[good], along_rows[good], atol=3e-5 * scale)


def test_logarithm_for_cameras_with_a_centre() -> None:
    assert not ray_field(load("paper-simulation").camera).logarithmic
    scene = load("monitor-mirror")
    assert isinstance(scene.camera, PinholeCamera)
    assert ray_field(scene.camera).logarithmic


def test_every_other_pixel() -> None:
    """A step of two doubles the slopes and takes its rays from the fine grid."""
    scene = resize(load("paper-simulation"), SIZE, SIZE)
    rays, plane = ray_field(scene.camera), pattern_plane(scene)
    truth = trace(scene, dent("raised-cosine", scene))
    w = -rays.inner_origins[2] / rays.inner_directions[2]
    fine = slopes(rays, plane, truth.u, truth.v, w)
    pick = (slice(None, None, 2), slice(None, None, 2))
    u, v, w = (np.ascontiguousarray(a[pick]) for a in (truth.u, truth.v, w))
    for coarse, value in zip(slopes(rays, plane, u, v, w, step=2), fine, strict=True):
        np.testing.assert_allclose(coarse, 2 * value[pick], rtol=1e-12, atol=1e-12)
