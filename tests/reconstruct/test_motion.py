"""The motion between rest and press, against rigs that are moved before `scene.trace` looks at them."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import Correspondence
from optolever.reconstruct import (
    Motion,
    MotionPrior,
    exact_correspondence,
    fit_motion,
    reconstruct,
    same_capture,
)
from optolever.scene import (
    Face,
    PinholeCamera,
    Scene,
    Surface,
    TelecentricCamera,
    adjusted,
    dent_from_text,
    load,
    resize,
    trace,
)

NOISE = 0.015
ARCSECONDS = np.radians(5 / 3600)
Floats = np.ndarray


@lru_cache(maxsize=3)
def rig(name: str) -> Scene:
    """`prism48`, `monitor-mirror`, or the prism seen by a pinhole 100 mm behind its capture face."""
    if name != "behind":
        return resize(load(name), 120, 160)
    base = resize(load("prism48"), 120, 160)
    view = base.camera
    assert isinstance(view, TelecentricCamera)
    half, axis = np.array([79.5, 59.5]), np.cross(view.u_axis, view.v_axis)
    middle = view.origin + half @ (view.pitch[:, None] * np.stack([view.u_axis, view.v_axis]))
    face, focal = Face(middle, axis, 1.41), 120.0 / view.pitch
    origin = middle - 100.0 * axis
    camera = PinholeCamera(origin, view.u_axis, view.v_axis, focal, half, 120, 160, face=face)
    return replace(base, camera=camera)


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


def capture(scene: Scene, surface: Surface, rng: np.random.Generator) -> Correspondence:
    seen = exact_correspondence(trace(scene, surface), NOISE)
    return replace(
        seen,
        u=seen.u + NOISE * rng.standard_normal(seen.u.shape),
        v=seen.v + NOISE * rng.standard_normal(seen.u.shape),
    )


def pressed(name: str, scene: Scene) -> Surface:
    """A dent by its text; `a + b`: the sum of two."""
    parts = [dent_from_text(text, scene) for text in name.split("+")]

    def height(x: Floats, y: Floats) -> Floats:
        total: Floats = np.sum([part.height(x, y) for part in parts], axis=0)
        return total

    def gradient(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        slopes: Floats = np.sum([part.gradient(x, y) for part in parts], axis=0)
        return slopes[0], slopes[1]

    return Surface(height, gradient)


def fitted(
    name: str, dent: str, seed: int, scale: float, image: float | None = None
) -> tuple[Motion, Floats]:
    """The motion of a drawn rig, and its true field on the flat mirror (2, H, W)."""
    rng, scene = np.random.default_rng(seed), rig(name)
    other, flat = moved(scene, rng, scale, image), dent_from_text("flat", scene)
    found = fit_motion(capture(other, pressed(dent, scene), rng), capture(scene, flat, rng), scene)
    before, after = trace(scene, flat), trace(other, flat)
    return found, np.stack([after.u - before.u, after.v - before.v])


def error_over_sigma(found: Motion, true: Floats) -> tuple[float, float, float]:
    """rms error and sigma of the field at rest, px, and the rms of the true one."""
    rest = replace(found, gradient=np.zeros_like(found.gradient))
    seen = np.isfinite(true)
    error = (np.stack(rest.field()) - true)[seen]
    variance = (rest.modes() ** 2).sum(axis=0)[seen]
    return tuple(float(np.sqrt(np.mean(part))) for part in (error**2, variance, true[seen] ** 2))  # type: ignore[return-value]


SMALL = {
    "prism48": "gaussian:peak=0.3,sigma=4",
    "behind": "needle:peak=0.2,decay=2",
    "monitor-mirror": "gaussian:peak=0.1,sigma=10",
}
LARGE = {
    "prism48": "ball:peak=0.3,radius=30",
    "behind": "raised-cosine:peak=0.3",
    "monitor-mirror": "ball:peak=0.1,radius=300",
}
TWO = "gaussian:peak=0.2,sigma=3,x=18,y=14+ball:peak=0.1,radius=20,x=42,y=30"


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("scale", [1.0, 5.0])
def test_the_motion_is_found_beside_a_small_dent(name: str, scale: float) -> None:
    draws = [error_over_sigma(*fitted(name, SMALL[name], seed, scale)) for seed in range(4)]
    error, sigma, true = np.sqrt(np.mean(np.square(draws), axis=0))
    assert error < 0.1 * true
    assert 0.3 < error / sigma < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(("name", "dent"), [*LARGE.items(), ("prism48", TWO)])
def test_a_dent_all_over_the_mirror_is_not_taken_for_motion(name: str, dent: str) -> None:
    draws = [error_over_sigma(*fitted(name, dent, seed, 1.0)) for seed in range(8)]
    error, sigma, true = np.sqrt(np.mean(np.square(draws), axis=0))
    assert error < 1.1 * true
    assert 0.4 < error / sigma < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE)
def test_without_motion_nothing_is_removed(name: str) -> None:
    for dent in ("flat", SMALL[name], LARGE[name]):
        draws = [fitted(name, dent, seed, 0.0) for seed in range(4)]
        assert not any(found.notices for found, _ in draws)
        error, sigma, _ = np.sqrt(np.mean(np.square([error_over_sigma(*draw) for draw in draws]), axis=0))
        assert error < min(1.5 * sigma, 0.5 * NOISE)


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", SMALL)
def test_a_motion_beyond_its_prior_has_a_notice(name: str) -> None:
    found, _ = fitted(name, SMALL[name], 0, 1.0, image=0.3)
    (notice,) = found.notices
    assert "moved between the rest capture and the press" in str(notice)
    assert notice.size > notice.limit


def test_parameters_without_a_field_keep_their_prior() -> None:
    found, _ = fitted("prism48", "flat", 3, 1.0)
    along = rig("prism48").camera
    axis = np.cross(along.u_axis, along.v_axis)  # a telecentric camera may move along its rays
    names = [found.names.index(f"camera.{letter}") for letter in "xyz"]
    assert axis @ found.values[names] == pytest.approx(0, abs=1e-6)
    variance = axis @ found.covariance[np.ix_(names, names)] @ axis
    assert np.sqrt(variance) == pytest.approx(1e-3, rel=1e-3)


def test_the_prior_is_the_answer_where_no_pixel_is_good() -> None:
    scene = rig("prism48")
    rest = capture(scene, dent_from_text("flat", scene), np.random.default_rng(0))
    dark = replace(rest, flags=np.ones_like(rest.flags))
    found = fit_motion(dark, rest, scene)
    assert found.quiet == 0
    assert not found.values.any()
    assert np.allclose(found.covariance, np.diag(found.prior**2))
    assert np.isfinite(found.modes()).all()


def test_a_smaller_prior_claims_less() -> None:
    rng, scene = np.random.default_rng(1), rig("prism48")
    flat = dent_from_text("flat", scene)
    one, other = capture(scene, flat, rng), capture(scene, flat, rng)
    still = MotionPrior(image=0.0, turn=0.0, shift=1e-9, sag=0.0)
    found = fit_motion(one, other, scene, still)
    assert "image.u" not in found.names
    assert np.abs(found.field()).max() < 1e-6


def test_heights_less_the_motion() -> None:
    rng, scene = np.random.default_rng(4), rig("prism48")
    surface = pressed(SMALL["prism48"], scene)
    now = capture(moved(scene, rng), surface, rng)
    rest = capture(scene, dent_from_text("flat", scene), rng)
    found, true = fit_motion(now, rest, scene), trace(scene, surface).z

    def height(field: Floats) -> Floats:
        kept = replace(now, u=now.u - field[0], v=now.v - field[1])
        solved = reconstruct(kept, replace(scene, accuracy=None), rest=rest)
        return np.where(solved.good, np.stack([solved.z, solved.sigma]), np.nan)

    field = np.stack(found.field())
    (before, _), (after, noise) = height(0 * field), height(field)
    spread = [height(field + mode)[0] - after for mode in found.modes()]
    total = np.sqrt(noise**2 + np.sum(np.square(spread), axis=0))
    assert np.nanstd(after - true) < 0.4 * np.nanstd(before - true)
    assert 0.3 < np.sqrt(np.nanmean(((after - true) / total) ** 2)) < 1.5


def test_the_press_given_as_its_own_rest() -> None:
    rng, scene = np.random.default_rng(1), rig("prism48")
    flat = dent_from_text("flat", scene)
    one, other = capture(scene, flat, rng), capture(scene, flat, rng)
    assert same_capture(one, one)
    assert same_capture(replace(one, u=one.u.astype(np.float32)), one)
    assert not same_capture(one, other)
    wide = replace(one, sigma_u=9 * one.sigma_u, sigma_v=9 * one.sigma_v)
    assert not same_capture(wide, other)


def test_sizes_must_agree() -> None:
    zero = np.zeros((8, 8))
    small = Correspondence(zero, zero, zero, zero, np.zeros((8, 8), np.uint16))
    with pytest.raises(InputError, match="8 x 8 pixels"):
        fit_motion(small, small, rig("prism48"))
    assert not same_capture(small, replace(small, flags=small.flags + 1))
