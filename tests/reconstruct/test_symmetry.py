"""A mirrored measurement gives the mirrored mirror; a scene in metres gives the same one."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.reconstruct import PointAnchor, reconstruct, slope_map
from optolever.scene import PinholeCamera, Scene

DENT = "gaussian:peak=1.3,sigma=20,x=70,y=60"  # off the middle in x and y


def mirrored(seen: Correspondence, rows: int) -> Correspondence:
    """What the other half of the prism sees of the dent on the other side: y -> width - y."""
    names = ("u", "v", "sigma_u", "sigma_v", "flags")
    fields = {name: np.flipud(getattr(seen, name)).copy() for name in names}
    return Correspondence(**{**fields, "v": rows - 1 - fields["v"]})


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("holes", [False, True])
def test_mirrored_correspondences_give_the_mirrored_height(exact, noisy, noise: float, holes: bool) -> None:
    scene, truth, _ = exact("paper-simulation", DENT, 64, 64)
    seen = noisy(truth, 0.05, noise, seed=3)
    if holes:
        lost = np.random.default_rng(2).random(truth.u.shape) < 0.05
        seen = replace(seen, flags=np.where(lost, 1, seen.flags).astype(np.uint16))
    straight = reconstruct(seen, scene)
    other = reconstruct(mirrored(seen, scene.pattern.rows), scene)
    good = straight.good
    np.testing.assert_array_equal(np.flipud(other.flags), straight.flags)
    exact_limit = 1e-8 * np.nanmax(truth.z)  # iterations stop at 1e-10 of the first residual
    limit = exact_limit if noise == 0 and not holes else 0.05 * straight.sigma[good]
    assert np.all(np.abs(np.flipud(other.z) - straight.z)[good] < limit)
    slopes, turned = (slope_map(*pair, scene) for pair in ((straight, seen), (other, mirrored(seen, 64))))
    np.testing.assert_allclose(np.flipud(turned.slope_y)[good], -slopes.slope_y[good], atol=1e-6)


def in_metres(scene: Scene) -> Scene:
    camera = scene.camera
    assert isinstance(camera, PinholeCamera)
    k = 1e-3
    return replace(
        scene,
        mirror=replace(scene.mirror, length=k * scene.mirror.length, width=k * scene.mirror.width),
        pattern=replace(scene.pattern, origin=k * scene.pattern.origin, pitch=k * scene.pattern.pitch),
        camera=replace(camera, origin=k * camera.origin),
    )


@pytest.mark.parametrize("method", ["coupled", "fixed-point"])
def test_a_pinhole_rig_in_metres(exact, method: str) -> None:
    scene, truth, seen = exact("monitor-mirror", "gaussian", 64, 64)
    point = (truth.x[32, 32], truth.y[32, 32], truth.z[32, 32])
    straight = reconstruct(seen, scene, method=method, anchor=PointAnchor(*point))
    small = PointAnchor(*(1e-3 * part for part in point))
    scaled = reconstruct(seen, in_metres(scene), method=method, anchor=small)
    assert np.nanmax(np.abs(1e3 * scaled.z - straight.z)) < 1e-9 * np.nanmax(truth.z)
    np.testing.assert_allclose(1e3 * scaled.sigma, straight.sigma, rtol=1e-6)
