"""Contacts of height maps against closed forms: Hertz' ball, Gaussians."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.reconstruct import Contact, HeightFlag, PixelAnchor, contacts, reconstruct
from optolever.scene import (
    Scene,
    Surface,
    adjusted,
    dent_from_text,
    load,
    parameter_values,
    resize,
    rig_covariance,
    trace,
)

SIDE = 128
MIDDLE = 0.5 * 163.7
NOISE = 0.05


def measured(scene: Scene, seen: Correspondence, anchor: PixelAnchor | None = None) -> tuple[Contact, ...]:
    return contacts(reconstruct(seen, scene, anchor=anchor))


def found_in(
    scene: Scene, surface: Surface, noisy: Callable[..., Correspondence], seed: int = 0
) -> tuple[Contact, ...]:
    """Contacts of a surface that is known in its middle, from correspondences with noise."""
    truth = trace(scene, surface)
    row, col = scene.camera.rows // 2, scene.camera.cols // 2
    anchor = PixelAnchor(float(row), float(col), float(truth.z[row, col]))
    return measured(scene, noisy(truth, NOISE, NOISE, seed), anchor)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return resize(load("paper-simulation", exact=True), SIDE, SIDE)


def shifted_sum(scene: Scene, *dents: str) -> Surface:
    surfaces = [dent_from_text(dent, scene) for dent in dents]

    def gradient(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = [surface.gradient(x, y) for surface in surfaces]
        return sum(p[0] for p in parts), sum(p[1] for p in parts)

    return Surface(lambda x, y: sum(surface.height(x, y) for surface in surfaces), gradient)


@pytest.fixture(scope="module")
def balls(scene: Scene, noisy) -> list[Contact]:
    """Hertz: depth 1.3, contact radius 20, R = 20^2/1.3, at x = 85 mm, y = 78 mm, over seeds."""
    ball = dent_from_text(f"ball:peak=1.3,radius={400 / 1.3},x=85,y=78", scene)
    return [found_in(scene, ball, noisy, seed)[0] for seed in range(8)]


@pytest.mark.parametrize(
    ("name", "expected", "least"),
    [
        ("depth", 1.3, 0.35),  # a tip between cells may be a cone's
        ("area", np.pi * 400, 0.3),
        ("volume", 0.75 * 1.3 * np.pi * 400, 0.3),
        ("indenter_radius", 400 / 1.3, 0.2),
    ],
)
def test_error_bars_hold(balls: list[Contact], name: str, expected: float, least: float) -> None:
    """Over seeds: no error is beyond what its bar allows; of area, volume and radius it is an upper bound."""
    ratio = np.array([(getattr(c, name) - expected) / getattr(c, f"{name}_sigma") for c in balls])
    assert least < np.sqrt(np.mean(ratio**2)) < 1.4
    assert np.abs(ratio).max() < 3.5


def test_the_centroid_is_where_the_ball_is(balls: list[Contact]) -> None:
    off = np.array([np.subtract((c.x, c.y), (85, 78)) / c.position_sigma for c in balls])
    assert 0.3 < np.sqrt(np.mean(off**2)) < 1.4


@pytest.mark.parametrize(
    ("dent", "depth", "half_area"),
    [
        ("raised-cosine:peak=1.3", 1.3, None),
        ("gaussian:peak=1.3,sigma=20", 1.3, 2 * np.pi * 400 * np.log(2)),
        ("gaussian:peak=1.3,sigma=10", 1.3, 2 * np.pi * 100 * np.log(2)),
        ("rounded-needle:peak=0.5,decay=20,rounding=10", 0.5, None),
    ],
)
def test_dents_have_their_figures(
    dent: str, depth: float, half_area: float | None, scene: Scene, noisy
) -> None:
    (contact,) = found_in(scene, dent_from_text(dent, scene), noisy)
    assert contact.depth == pytest.approx(depth, rel=2e-3)
    if half_area is not None:
        assert abs(contact.area - half_area) < max(4 * contact.area_sigma, 2e-3 * half_area)
        assert contact.volume == pytest.approx(contact.area * depth * 0.5 / np.log(2), rel=5e-3)


def test_nothing_pressed(scene: Scene, noisy) -> None:
    assert found_in(scene, dent_from_text("flat", scene), noisy) == ()


PRISM = 3.0  # mm: sigma of a Gaussian whose half-depth area is 2 pi 9 ln 2 = 39.2 mm^2


@pytest.fixture(scope="module")
def prism() -> Scene:
    return resize(load("prism48", exact=True), 120, 160)


def gaussians(scene: Scene, *places: tuple[float, float, float]) -> Surface:
    return shifted_sum(scene, *(f"gaussian:peak={peak},sigma={PRISM},x={x},y={y}" for peak, x, y in places))


def test_every_dent_is_measured_by_its_own_depth(prism: Scene, noisy) -> None:
    """Depths of 1, 0.67, 0.53, 0.33 and 0.1 of the deepest one, all of the same half-depth area."""
    places = ((0.3, 14, 12), (0.2, 40, 10), (0.16, 15, 33), (0.1, 46, 34), (0.03, 31, 24))
    seen = noisy(trace(prism, gaussians(prism, *places)), 0.01, 0.01)
    found = measured(prism, seen)
    assert len(found) == len(places)
    for contact, (peak, x, y) in zip(found, places, strict=True):
        assert abs(contact.depth - peak) < 4 * contact.depth_sigma + 1e-3 * peak
        assert contact.area == pytest.approx(2 * np.pi * PRISM**2 * np.log(2), rel=0.02)
        assert abs(contact.area - 2 * np.pi * PRISM**2 * np.log(2)) < 4 * contact.area_sigma
        np.testing.assert_allclose((contact.x, contact.y), (x, y), atol=4 * contact.position_sigma)
        assert not contact.cut
        assert not contact.hole


def test_holes_in_a_dent_are_interpolated(prism: Scene, noisy) -> None:
    """Flagged pixels at its top, on its outline and amid its flank."""
    truth = trace(prism, dent_from_text(f"gaussian:peak=0.2,sigma={np.sqrt(20)},x=30,y=22", prism))
    seen = noisy(truth, 0.01, 0.01)
    flags = seen.flags.copy()
    for x, y, size in ((30.5, 22.3, 1.1), (35, 22, 3.0), (28, 19, 1.1), (30, 27.3, 1.1)):
        flags[np.hypot(truth.x - x, truth.y - y) < size] |= 1
    whole, holed = (measured(prism, replace(seen, flags=each))[0] for each in (seen.flags, flags))
    expected = 2 * np.pi * 20 * np.log(2)
    for contact in (whole, holed):
        assert abs(contact.area - expected) < 3 * contact.area_sigma
        assert contact.area == pytest.approx(expected, rel=0.02)
        assert contact.depth - 0.2 < 3 * contact.depth_sigma
        assert contact.depth == pytest.approx(0.2, rel=1e-3 if contact is whole else 0.01)
    assert holed.hole
    assert holed.depth_at_least
    assert not whole.depth_at_least
    assert holed.area_sigma < 0.1 * expected


def test_a_hole_in_the_middle_makes_the_depth_a_lower_bound(prism: Scene, noisy) -> None:
    """The cap of a steep dent is flagged: nothing shows how deep it is."""
    truth = trace(prism, dent_from_text("gaussian:peak=0.3,sigma=1,x=30,y=22", prism))
    seen = noisy(truth, 0.01, 0.01)
    flags = np.where(np.hypot(truth.x - 30, truth.y - 22) < 1.6, seen.flags | 1, seen.flags)
    (contact,) = measured(prism, replace(seen, flags=flags.astype(np.uint16)))
    assert contact.hole
    assert contact.depth_at_least
    assert 0.06 < contact.depth < 0.29


@pytest.mark.parametrize("shape", ["gaussian:peak=0.2,sigma=3", "ball:peak=0.2,radius=60"])
def test_contacts_that_the_image_cuts(shape: str, prism: Scene, noisy) -> None:
    """At several distances from unknown pixels: by the elastic field around a ball, else lower bounds."""
    truth = trace(prism, dent_from_text(f"{shape},x=30,y=22", prism))
    seen = noisy(truth, 0.01, 0.01)
    row, col = np.unravel_index(np.nanargmin(np.hypot(truth.x - 10, truth.y - 22)), truth.x.shape)
    anchor = PixelAnchor(float(row), float(col), float(truth.z[row, col]))
    (whole,) = measured(prism, seen)
    assert not whole.cut
    for end in (29.0, 31.0, 32.0, 40.0):
        flags = np.where(truth.x > end, seen.flags | 1, seen.flags).astype(np.uint16)
        (contact,) = measured(prism, replace(seen, flags=flags), anchor)
        assert contact.cut == (end < 40.0)
        if contact.cut:
            assert contact.force_at_least == shape.startswith("gaussian")
            for off, sigma in (
                (contact.area - whole.area, contact.area_sigma),
                (contact.volume - whole.volume, contact.volume_sigma),
            ):
                assert off < 3 * sigma
                assert contact.force_at_least or off > -3 * sigma
        else:
            assert contact.area == pytest.approx(whole.area, rel=0.02)


def test_positions_and_areas_hold_the_errors_of_the_rig(prism: Scene, noisy) -> None:
    """A shift, a turn about the mirror's middle and a scale of 1 %, which change no height: closed form."""
    seen = noisy(trace(prism, gaussians(prism, (0.2, 20, 12))), 0.01, 0.01)
    height = reconstruct(seen, prism)
    (sure,) = contacts(height)
    turn, scale = 0.02, 0.01
    moves = [[[0.5, 0, 0], [0, 0, 0]], [[turn * 22.5, 0, -turn], [-turn * 30, turn, 0]]]
    moves += [[[0, scale, 0], [0, 0, scale]]]
    (contact,) = contacts(replace(height, displacement=np.array(moves)))
    expected = [np.hypot(0.5, turn * 10.5), turn * 10]
    scaled = [scale * 20, scale * 12]
    middle = np.sqrt(contact.position_sigma**2 - sure.position_sigma**2)
    assert middle == pytest.approx(np.linalg.norm(np.hypot(expected, scaled)) / np.sqrt(2), rel=0.02)
    area = np.sqrt(contact.area_sigma**2 - sure.area_sigma**2)
    assert area == pytest.approx(2 * scale * contact.area, rel=0.02)
    assert contact.depth_sigma == sure.depth_sigma


def test_errors_that_a_dent_shares_with_its_surroundings_cancel(prism: Scene, noisy) -> None:
    """A draw of modes of 0.4 mm, constant, tilted and twisted, is on the map: every dent is found, its depth
    over the surface at rest within its sigma."""
    seen = noisy(trace(prism, gaussians(prism, (0.3, 20, 14), (0.1, 40, 30))), 0.01, 0.01)
    height = reconstruct(seen, prism)
    s, t = height.x / 30 - 1, height.y / 22.5 - 1
    modes = 0.4 * np.nan_to_num(np.stack([np.ones_like(s), s, t, s * t])).astype(np.float32)
    for seed in range(4):
        drawn = np.random.default_rng(seed).standard_normal(4)
        z = height.z + np.tensordot(drawn, modes, 1)
        wrong = replace(height, z=z, modes=modes)
        found = contacts(wrong)
        assert len(found) == 2
        for contact, depth in zip(found, (0.3, 0.1), strict=True):
            assert abs(contact.depth - depth) < 2.5 * contact.depth_sigma
            assert contact.depth_sigma < 0.2 * depth


def test_a_bulge_that_the_rig_explains_is_no_dent(prism: Scene, noisy) -> None:
    """A Gaussian of 0.05 mm on the map, and a mode of the same shape and size."""
    seen = noisy(trace(prism, gaussians(prism, (0.3, 18, 14), (0.05, 40, 30))), 0.01, 0.01)
    height = reconstruct(seen, prism)
    bulge = gaussians(prism, (0.05, 40, 30)).height(height.x, height.y)
    modes = np.nan_to_num(bulge[None]).astype(np.float32)
    known = replace(height, modes=modes)
    assert len(contacts(height)) == 2
    (contact,) = contacts(known)
    assert contact.depth == pytest.approx(0.3, abs=4 * contact.depth_sigma + 3e-4)


def test_a_rim_on_a_rig_that_is_not_as_typed_is_no_wrong_correspondence(noisy) -> None:
    """Slopes that a wrong rig turns contradict each other: the most where a ball's rim makes them jump."""
    scene, texts = resize(load("prism48"), 90, 120), ("ball:peak=.06,radius=250", "flat")
    covariance, own = rig_covariance(scene), parameter_values(scene)
    assert covariance is not None
    for seed in (0, 2):
        errors = np.random.default_rng(seed).standard_normal(len(covariance.root)) @ covariance.root
        wrong = {name: own[name] + by for name, by in zip(covariance.names, errors, strict=True)}
        rig = adjusted(replace(scene, accuracy=None), wrong)
        seen, rest = (noisy(trace(rig, dent_from_text(text, rig)), 0.004, 0.004, seed) for text in texts)
        height = reconstruct(seen, scene, rest=rest)
        assert not (height.flags & HeightFlag.CURL).any()
        (one,) = contacts(height)
        assert not one.hole
        assert abs(one.depth - 0.06) < 2 * one.depth_sigma < 0.015
        assert abs(one.area - np.pi * 250 * 0.06) < 2 * one.area_sigma < 0.25 * one.area
