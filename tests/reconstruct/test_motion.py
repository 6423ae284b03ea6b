"""The motion between rest and press, against rigs that are moved before `scene.trace` looks at them."""

from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np
import pytest

from lab.live.world import BALL
from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap, budget, contacts, reconstruct
from optolever.scene import (
    PinholeCamera,
    Scene,
    Surface,
    adjusted,
    dent_from_text,
    load,
    parameter_values,
    resize,
    trace,
)

from .conftest import correspondence_of, pressed_half_space

NOISE = 0.015
ARCSECONDS = np.radians(5 / 3600)
Floats = np.ndarray


@lru_cache(maxsize=2)
def rig(name: str) -> Scene:
    return resize(load(name), 120, 160)


def moved(scene: Scene, rng: np.random.Generator, scale: float = 1.0, image: float | None = None) -> Scene:
    """Each pose by 1 um and 5 arcseconds, the image by 0.02 px (along u: `image`)."""
    numbers = {
        f"{part}.{axis}": scale * (ARCSECONDS if axis[0] == "r" else 1e-3) * rng.standard_normal()
        for part in ("camera", "pattern")
        for axis in ("x", "y", "z", "rx", "ry", "rz")
    }
    posed = adjusted(scene, numbers)
    shift = scale * 0.02 * rng.standard_normal(2)
    if image is not None:
        shift[0] = image
    camera = posed.camera
    if isinstance(camera, PinholeCamera):
        return replace(posed, camera=replace(camera, centre=camera.centre - shift))
    by = shift * camera.pitch
    return replace(
        posed, camera=replace(camera, origin=camera.origin + by[0] * camera.u_axis + by[1] * camera.v_axis)
    )


def capture(scene: Scene, surface: Surface, rng: np.random.Generator, noise: float = NOISE) -> Correspondence:
    return correspondence_of(trace(scene, surface), noise, noise, rng)


def solved(
    name: str, dent: str, seed: int, scale: float, image: float | None = None
) -> tuple[HeightMap, Floats]:
    """The height against rest of a rig that has moved since, and its error (H, W), mm."""
    rng, scene = np.random.default_rng(seed), rig(name)
    now, surface = moved(scene, rng, scale, image), dent_from_text(dent, scene)
    rest = capture(scene, dent_from_text("flat", scene), rng)
    height = reconstruct(capture(now, surface, rng), scene, rest=rest)
    return height, np.where(height.good, height.z - trace(scene, surface).z, np.nan)


def moves(height: HeightMap) -> bool:
    return any("rig moved" in str(notice) for notice in height.notices)


def own_sigma(height: HeightMap) -> Floats:
    """Of noise and motion alone, mm."""
    assert height.modes is not None
    own = replace(height, modes=height.modes[-height.own :], sources=(), shares=None, displacement=None)
    return np.asarray(np.hypot(own.sigma, own.calibration_sigma))


SMALL = {"prism48": "gaussian:peak=0.3,sigma=4", "monitor-mirror": "gaussian:peak=0.1,sigma=10"}


@pytest.mark.daily(2)
@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("scale", [0.0, 1.0, 5.0])
def test_sigma_holds_a_motion(name: str, scale: float) -> None:
    """That of noise and motion alone, as the numbers are as typed. Without any there is no notice."""
    ratios = []
    for seed in range(4):
        height, error = solved(name, SMALL[name], seed, scale)
        assert scale > 0 or not moves(height)
        ratios.append(np.sqrt(np.nanmean((error / own_sigma(height)) ** 2)))
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 1.5


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", SMALL)
def test_a_motion_beyond_its_prior_has_a_notice(name: str) -> None:
    height, error = solved(name, SMALL[name], 0, 1.0, image=0.5)
    assert moves(height)
    # the mirror may have sunk by 85 um on the prism and .5 mm before the monitor: that is in total_sigma, too
    least = {"prism48": 0.005, "monitor-mirror": 0.0003}[name]
    assert least < np.sqrt(np.nanmean((error / height.total_sigma) ** 2)) < 1.5
    assert 0.5 < np.sqrt(np.nanmean((error / own_sigma(height)) ** 2)) < 2.5


@pytest.mark.parametrize("number", ["camera.f", "pattern.pitch"])
@pytest.mark.parametrize(("growth", "most", "um"), [(1e-4, 1.2, 0.3), (3e-4, 3.0, 1.5)])
def test_a_rig_that_warms_keeps_its_dent(number: str, growth: float, most: float, um: float) -> None:
    """By one standard deviation of growth and by three. As motions alone these cost 1.4 to 10 um of a dent of
    20 um, or its contact."""
    rng, scene = np.random.default_rng(3), resize(load("monitor-mirror"), 96, 120)
    now = adjusted(scene, {number: (1 + growth) * parameter_values(scene)[number]})
    surface = dent_from_text("gaussian:peak=0.02,sigma=10", scene)
    rest = capture(scene, dent_from_text("flat", scene), rng)
    height = reconstruct(capture(now, surface, rng), scene, rest=rest)
    error = np.where(height.good, height.z - trace(scene, surface).z, np.nan)
    assert np.sqrt(np.nanmean((error / height.total_sigma) ** 2)) < most
    assert 1e3 * np.sqrt(np.nanmean(error**2)) < um
    assert len(contacts(height)) == 1


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 10), marks=pytest.mark.slow)])
def test_sigma_of_noise_against_rest(seeds: range) -> None:
    """Noise of 0.03 px, the rest capture's a tenth of it or the same, of an exact rig, untouched."""
    scene, ratios = resize(load("prism48", exact=True), 120, 160), []
    surface = dent_from_text("flat", scene)
    for seed, share in product(seeds, (0.1, 1.0)):
        rng = np.random.default_rng(seed)
        now, rest = capture(scene, surface, rng, 0.03), capture(scene, surface, rng, share * 0.03)
        height = reconstruct(now, scene, rest=rest)
        ratios.append(np.sqrt(np.mean((height.z / height.total_sigma)[height.good] ** 2)))
    assert 0.6 < min(ratios) <= max(ratios) < 1.3


def test_the_press_given_as_its_own_rest() -> None:
    rng, scene = np.random.default_rng(1), rig("prism48")
    one, other = (capture(scene, dent_from_text("flat", scene), rng) for _ in range(2))
    for rest, same in ((replace(one, u=one.u.astype(np.float32)), True), (other, False)):
        assert (
            any("same capture" in notice.name for notice in reconstruct(one, scene, rest=rest).notices)
            == same
        )


@pytest.mark.parametrize(("width", "exact"), [(10, False), (20, False), (10, True), (20, True), (30, True)])
@pytest.mark.parametrize("place", ["x=75,y=55", "x=97.5,y=44"])
def test_a_wide_dent_is_no_error_of_the_rig(width: int, exact: bool, place: str) -> None:
    """Without a rest capture, at the mirror's middle, which counts as at rest, and beside it: depths counted
    from there, 4 to 25 sigma too small, or there was no contact."""
    scene, rng = resize(load("monitor-mirror", exact=exact), 96, 120), np.random.default_rng(1)
    surface = dent_from_text(f"gaussian:peak=0.1,sigma={width},{place}", scene)
    (found,) = contacts(reconstruct(capture(scene, surface, rng), scene))
    assert abs(found.depth - 0.1) < 2 * found.depth_sigma < 0.02


@pytest.mark.parametrize("width", [7, 9, 11])
@pytest.mark.parametrize("place", ["x=30,y=22", "x=40,y=22"])
def test_a_dent_that_reaches_the_anchor_is_no_motion(width: int, place: str) -> None:
    """Against rest: heights were 2 to 7 sigma off, up to a tenth of the depth."""
    scene, rng = resize(load("prism48"), 96, 128), np.random.default_rng(2)
    surface = dent_from_text(f"gaussian:peak=0.06,sigma={width},{place}", scene)
    rest = capture(scene, dent_from_text("flat", scene), rng)
    height = reconstruct(capture(scene, surface, rng), scene, rest=rest)
    error = np.where(height.good, height.z - trace(scene, surface).z, np.nan)
    assert 0.1 < np.sqrt(np.nanmean((error / height.total_sigma) ** 2)) < 1.3  # the typed rig is exact
    assert np.nanmedian(height.total_sigma) < 0.06 / 8


def named_shift(height: HeightMap) -> list[str]:
    return [str(one) for one in height.notices if "moved as a whole" in one.name]


@pytest.mark.parametrize(("name", "sunk"), [("monitor-mirror", 0.15), ("prism48", 0.02)])
def test_a_mirror_that_sinks_evenly_is_in_total_sigma_and_named(name: str, sunk: float) -> None:
    """Heights do not show it: it is the picture of a camera that moved. A tenth of it is no more than rigs
    move, and in total sigma; without it there is neither."""
    scene, rng = resize(load(name), 96, 120), np.random.default_rng(1)
    dent, flat = dent_from_text(SMALL[name], scene), dent_from_text("flat", scene)
    rest = capture(scene, flat, rng)
    for depth in (0.0, 0.1 * sunk, sunk):
        lower = Surface(lambda x, y, by=depth: dent.height(x, y) + by, dent.gradient)  # type: ignore[misc]
        height = reconstruct(capture(scene, lower, rng), scene, rest=rest)
        error = (height.z - trace(scene, lower).z)[height.good]
        ratio = np.sqrt(np.mean(np.square(error / height.total_sigma[height.good])))
        assert 0.2 < ratio < 1.2
        assert (height.sinking > 0) == (depth > 0)
        named = named_shift(height)
        assert len(named) == (depth == sunk)
    size = float(named[0].partition("sank by ")[2].partition(" µm")[0])
    assert size == pytest.approx(1e3 * sunk, rel=0.1)


BALLS = {
    "ball": ((BALL, 28.0, 20.0, 4.0, 0.08),),
    "two": ((BALL, 22.0, 15.0, 3.0, 0.05), (BALL, 38.0, 30.0, 4.0, 0.04)),
    "untouched": (),
}


SAG = "sag under the load, motion since rest"


@pytest.mark.parametrize("dents", BALLS)
@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("noise", [(0.01, 0.01), (0.003, 0.03)], ids=["alike", "quiet rest"])
def test_a_dent_is_no_motion(dents: str, exact: bool, noise: tuple[float, float]) -> None:
    """Its slopes move the picture, too: the median over all of it named 48 of 51 right maps. The sag under
    balls on a half-space comes off."""
    scene = resize(load("prism48", exact=exact), 120, 160)
    rest, _ = pressed_half_space(scene, (), noise[0], 1)
    press, true = pressed_half_space(scene, BALLS[dents], noise[1], 2)
    height = reconstruct(press, scene, rest=rest)
    assert not height.notices
    assert {"moved", "circulation", "converged", "load"} <= {test.test for test in height.tests}
    assert not any(test.fails for test in height.tests)
    ratio, alone = (((height.z - true) / one)[height.good] for one in (height.total_sigma, height.sigma))
    assert (0.5 if exact else 0.15) < np.sqrt(np.mean(np.square(ratio))) < 1.3
    if dents != "untouched":
        assert np.sqrt(np.mean(np.square(alone))) < 2.5  # above 10 with it
        assert budget(height)["height (deepest)"][SAG] > 0


@pytest.mark.parametrize("pixels", [0.05, 0.3])
def test_a_camera_that_moved_before_an_exact_rig_is_named(pixels: float) -> None:
    """By .05 px heights are 8 um off, beyond the sigma of an exact rig."""
    scene = resize(load("prism48", exact=True), 120, 160)
    camera = scene.camera
    origin = camera.origin + pixels * camera.pitch[0] * camera.u_axis
    rest, _ = pressed_half_space(scene, (), 0.01, 1)
    now = replace(scene, camera=replace(camera, origin=origin))
    press, true = pressed_half_space(now, BALLS["ball"], 0.01, 2)
    height = reconstruct(press, scene, rest=rest)
    assert len(named_shift(height)) == 1
    (figure,) = [test.figure for test in height.tests if test.test == "moved"]
    assert figure == pytest.approx(pixels, rel=0.1)
    assert not any("silicone" in str(notice) for notice in height.notices)
    error = np.abs(height.z - true)[height.good]
    assert np.mean(error > 5 * height.total_sigma[height.good]) < 0.01
