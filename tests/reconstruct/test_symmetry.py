"""A measurement turned or mirrored gives the mirror turned or mirrored; a scene in metres the same one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.reconstruct import reconstruct, slope_map
from optolever.scene import Scene, TelecentricCamera

DENT = "gaussian:peak=1.3,sigma=20,x=70,y=60"  # off the middle in x and y
#: How maps lie after it.
CHANGES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "half turn": lambda a: np.rot90(a, 2),
    "quarter turn": np.rot90,
    "mirror image": np.flipud,
}


def changed(scene: Scene, seen: Correspondence, how: str) -> tuple[Scene, Correspondence]:
    """The same physics with the camera's pixels numbered otherwise; or what the prism's other half sees of
    the dent on the other side: y -> width - y."""
    names = ("u", "v", "sigma_u", "sigma_v", "flags")
    found = Correspondence(**{name: CHANGES[how](getattr(seen, name)).copy() for name in names})
    if how == "mirror image":
        return scene, replace(found, v=scene.pattern.rows - 1 - found.v)
    camera = scene.camera
    assert isinstance(camera, TelecentricCamera)
    last = camera.origin + (camera.cols - 1) * camera.pitch[0] * camera.u_axis
    if how == "half turn":
        far = last + (camera.rows - 1) * camera.pitch[1] * camera.v_axis
        return replace(
            scene, camera=replace(camera, origin=far, u_axis=-camera.u_axis, v_axis=-camera.v_axis)
        ), found
    axes = {"u_axis": camera.v_axis, "v_axis": -camera.u_axis, "pitch": camera.pitch[::-1].copy()}
    other = replace(camera, origin=last, rows=camera.cols, cols=camera.rows, **axes)
    return replace(scene, camera=other), found


@pytest.mark.daily(4)
@pytest.mark.parametrize(
    ("how", "noise"),
    [("half turn", 0.02), ("quarter turn", 0.02), ("mirror image", 0.0), ("mirror image", 0.05)],
)
@pytest.mark.parametrize("holes", [False, True])
def test_the_same_mirror_seen_otherwise(exact, noisy, how: str, noise: float, holes: bool) -> None:
    # the pattern is as wide as the mirror in a square camera alone
    seen_as = (DENT, 64, 64) if how == "mirror image" else ("raised-cosine", 96, 112)
    scene, truth, _ = exact("paper-simulation", *seen_as)
    seen = noisy(truth, noise or 0.05, noise, seed=3)
    if holes:
        lost = np.random.default_rng(2).random(truth.u.shape) < 0.05
        seen = replace(seen, flags=np.where(lost, 1, seen.flags).astype(np.uint16))
    other_scene, other = changed(scene, seen, how)
    straight, turned, turn = reconstruct(seen, scene), reconstruct(other, other_scene), CHANGES[how]
    np.testing.assert_array_equal(turned.flags, turn(straight.flags))
    good, sigma = turned.good, turn(straight.sigma)
    drawn = how == "quarter turn"  # sigma: in closed form one way, of 64 draws the other, uncertain by 9 %
    exact_limit = 1e-8 * np.nanmax(truth.z)  # iterations stop at 1e-10 of the first residual
    limit = exact_limit if noise == 0 and not holes else (0.1 if drawn else 0.05) * sigma[good]
    assert np.all(np.abs(turned.z - turn(straight.z))[good] < limit)
    off = np.abs(turned.sigma - turn(straight.sigma))[good]
    if drawn:
        assert np.median(off / sigma[good]) < 0.09
    else:
        assert np.all(off < limit)
    slopes = [slope_map(*each) for each in ((straight, seen, scene), (turned, other, other_scene))]
    sign = -1 if how == "mirror image" else 1
    near = 3e-4 if drawn else 1e-5
    np.testing.assert_allclose(slopes[1].slope_y[good], sign * turn(slopes[0].slope_y)[good], atol=near)
