"""Colour: pictures of three frames each against an independent renderer, and what is refused."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from optolever import InputError
from optolever.calibration import measure_colours
from optolever.decode import Correspondence, decode
from optolever.patterns import Sequence, packed, sequence_from_text
from optolever.projector import (
    NOMINAL_SENSOR,
    ColourCapture,
    ColourResponse,
    capture_colour,
    load_capture,
    unmixed,
)
from optolever.projector.unmixing import moved, quads, sites
from optolever.scene import MOSAICS, Display, Scene, dent_from_text, load, resize, trace

from .colour_light import MIX, seen_pictures

_OFFSET, _GAIN, _ELECTRONS = 16.0, 216.75, 30.0


def _response(mix: np.ndarray = MIX, sigma: float = 0.0, mosaic: str | None = None) -> ColourResponse:
    """The camera of these tests, known exactly."""
    levels, light = np.array([0.0, 255.0]), np.tile([0.0, 1.0], (3, 1))
    dark, scale = np.full(3, _OFFSET / 255), _GAIN / 255
    return ColourResponse(dark, mix * scale, np.full((3, 3), sigma * scale), 0.0, levels, light, mosaic)


def _levels(light: np.ndarray, seed: int, lag: float = 0.0) -> np.ndarray:
    """8-bit pictures with photon noise; lag: share of the picture before."""
    seen = light.copy()
    seen[1:] = (1 - lag) * light[1:] + lag * light[:-1]
    rng = np.random.default_rng(seed)
    level = rng.poisson(np.maximum(seen, 0) * _GAIN * _ELECTRONS) / _ELECTRONS + _OFFSET
    return np.clip(np.rint(level + 0.2 * rng.standard_normal(seen.shape)), 0, 255).astype(np.uint8)


def _scene() -> Scene:
    return resize(load("prism48", exact=True), 120, 160)


def _packed(text: str, stripes: str) -> Sequence:
    scene = _scene()
    return packed(sequence_from_text(text, scene.pattern.rows, scene.pattern.cols), stripes)


def _off(found: Correspondence, scene: Scene, axis: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors of good places and their sigma; the border, where the pattern ends, apart."""
    truth, inside = trace(scene, dent_from_text("flat", scene)), np.zeros(found.good.shape, bool)
    inside[4:-4, 4:-4] = True
    good = found.good & inside
    error = getattr(found, axis) - getattr(truth, axis)
    return error[good], getattr(found, f"sigma_{axis}")[good]


@pytest.mark.parametrize(
    ("text", "stripes", "lag"),
    [
        ("phase:periods=9/10/11", "none", 0.0),
        ("phase:periods=9/10/11", "rgb", 0.0),
        ("phase:periods=9/10/11", "none", 0.1),
        ("gray+phase", "bgr", 0.0),
        ("gray+phase", "none", 0.1),
    ],
)
def test_places_of_pictures_rendered_elsewhere_are_right_within_sigma(
    text: str, stripes: str, lag: float
) -> None:
    scene, shown = _scene(), _packed(text, stripes)
    light = seen_pictures(scene, shown, None if stripes == "none" else stripes, 120, 160)
    taken = unmixed(_levels(light, 3, lag), shown, _response())
    found = decode(taken.frames, taken.sequence)
    assert found.good[4:-4, 4:-4].mean() > 0.95
    for axis in "uv":
        error, sigma = _off(found, scene, axis)
        assert abs(error.mean()) < 0.001
        assert 0.8 < np.sqrt(np.median((error / sigma) ** 2) / 0.4549) < 1.2
        assert np.mean(np.abs(error) > 5 * sigma) < 1e-3


@pytest.mark.parametrize("mosaic", MOSAICS)
def test_raw_mosaics_are_read_at_the_centres_of_their_quads(mosaic: str) -> None:
    scene, shown = _scene(), _packed("phase:periods=9/10/11", "none")
    light = seen_pictures(scene, shown, None, 240, 320)
    raw = np.empty(light.shape[:3])
    for k, colour in enumerate(mosaic):
        part = np.s_[:, k // 2 :: 2, k % 2 :: 2]
        raw[part] = light[..., "RGB".index(colour)][part]
    taken = unmixed(_levels(raw, 4), shown, _response(mosaic=mosaic))
    found = decode(taken.frames, taken.sequence)
    assert found.good[4:-4, 4:-4].mean() > 0.95
    for axis in "uv":
        error, sigma = _off(found, scene, axis)
        assert abs(error.mean()) < 0.001
        # heights sum the slow part of the noise, of which places show three quarters
        assert 0.7 < np.sqrt(np.median((error / sigma) ** 2) / 0.4549) < 1.0


@pytest.mark.parametrize("gammas", [(1.0, 1.0, 1.0), (2.6, 2.2, 1.9)])
def test_the_virtual_sensor_takes_the_pictures_of_the_other_renderer(
    gammas: tuple[float, float, float],
) -> None:
    scene, shown = _scene(), _packed("gray+phase", "none")
    scene = replace(
        scene,
        sensor=replace(NOMINAL_SENSOR, gain_e=0.0, noise=0.0, bits=16, mix=MIX),
        display=Display(gammas=np.array(gammas)),
    )
    taken = capture_colour(scene, dent_from_text("flat", scene), shown, renderer="numpy")
    light = (taken.images / 65535 * 255 - _OFFSET) / _GAIN
    wanted = seen_pictures(scene, shown, None, 120, 160, gammas)
    assert np.abs(light - wanted)[:, 4:-4, 4:-4].max() < 0.005


@pytest.mark.parametrize("steps", [3, 4])
@pytest.mark.parametrize("wrong", ["bgr", "none", "camera"])
def test_a_ladder_of_another_order_of_colours_is_refused(wrong: str, steps: int) -> None:
    """Of the display's stripes, or of the camera's channels."""
    stated = "rgb" if wrong == "camera" else wrong
    scene, shown = _scene(), _packed(f"phase:periods=9/10/11,steps={steps}", stated)
    images = _levels(seen_pictures(scene, shown, "rgb", 120, 160), 5)
    taken = unmixed(images[..., ::-1] if wrong == "camera" else images, shown, _response())
    found = decode(taken.frames, taken.sequence)
    assert not found.good.any()
    assert "fringe orders of u are ambiguous" in found.notices[0].name or wrong == "bgr"
    assert "--colour" in found.notices[0].cure or wrong == "bgr"


@pytest.mark.parametrize("lag", [0.0, 0.015])
def test_a_lag_under_three_steps_without_bits_is_refused(lag: float) -> None:
    """From 1 % on: heights then err by 1.4 sigma and more."""
    scene, shown = _scene(), _packed("phase:periods=9/10/11,steps=3", "none")
    taken = unmixed(_levels(seen_pictures(scene, shown, None, 120, 160), 5, lag), shown, _response())
    found = decode(taken.frames, taken.sequence)
    assert found.good.any() == (lag == 0)
    assert any("which three steps take for places" in one.name for one in found.notices) == (lag > 0)


def test_unknown_stripes_are_an_error_that_all_pixels_share() -> None:
    """As large as the third of a cell by which red lies aside; its sigma is apart from that of places."""
    scene, shown = _scene(), _packed("gray+phase", "unknown")
    light = [seen_pictures(scene, shown, stripes, 120, 160) for stripes in ("rgb", "bgr")]
    for images, off in zip(light, (1 / 3, -1 / 3), strict=True):
        taken = unmixed(_levels(images, 5), shown, _response())
        found = decode(taken.frames, taken.sequence)
        assert not found.notices
        assert found.common_u == 1 / 3
        error, sigma = _off(found, scene, "u")
        assert error.mean() == pytest.approx(off, abs=0.003)
        assert 0.8 < np.sqrt(np.median(((error - error.mean()) / sigma) ** 2) / 0.4549) < 1.2
    with pytest.raises(InputError, match=r"need the display's stripes; state their order"):
        _packed("phase:periods=9/10/11", "unknown")


@pytest.mark.parametrize(
    ("true", "stated"),
    [("rgb", "bgr"), ("rgb", "none"), ("none", "bgr"), ("rgb", "rgb"), ("bgr", "bgr"), ("none", "none")],
)
def test_stripes_are_tested_by_bits(true: str, stated: str) -> None:
    scene, shown = _scene(), _packed("gray+phase", stated)
    light = seen_pictures(scene, shown, None if true == "none" else true, 120, 160)
    taken = unmixed(_levels(light, 5), shown, _response())
    found = decode(taken.frames, taken.sequence)
    named = any("stripes are not those stated" in notice.name for notice in found.notices)
    assert named == (true != stated)
    error, sigma = _off(found, scene, "u")
    assert np.mean(np.abs(error) > 3 * sigma) < 0.01


@pytest.mark.parametrize("stripes", [None, "rgb", "bgr"])
def test_stripes_are_measured_and_others_refused(stripes: str | None) -> None:
    """Of whatever the ramp was drawn for; `phase` shows wrong stripes by nothing else."""
    scene, response = _scene(), None
    for stated in ("rgb", "none", "unknown"):
        shown = _packed("ramp", stated)
        images = _levels(seen_pictures(scene, shown, stripes, 120, 160), 3)
        response = measure_colours(ColourCapture(images, shown))
        assert response.stripes == (stripes or "none")
        assert np.abs(response.mix * 3 / response.mix.sum() - MIX).max() < 0.003
    assert response is not None
    for stated in ("rgb", "bgr", "none", "unknown"):
        shown = _packed("gray+phase", stated)
        images = np.full((shown.exposures, 8, 8, 3), 99, np.uint8)
        if stated in (response.stripes, "unknown"):
            unmixed(images, shown, response)
            continue
        with pytest.raises(
            InputError, match=f"drawn for stripes {stated}, the display has {response.stripes}"
        ):
            unmixed(images, shown, response)


@pytest.mark.parametrize("text", ["phase:periods=9/10/11", "gray+phase"])
def test_blue_taken_for_red_is_named(text: str) -> None:
    scene, shown = _scene(), _packed(text, "none")
    images = _levels(seen_pictures(scene, shown, None, 120, 160), 6)[..., ::-1]
    found = decode(*(lambda c: (c.frames, c.sequence))(unmixed(images, shown, _response())))
    assert found.good.mean() < 0.3
    assert found.notices


def test_a_mix_that_is_1_percent_wrong_is_in_sigma() -> None:
    scene, shown = _scene(), _packed("gray+phase", "none")
    wrong = MIX + 0.01 * np.random.default_rng(8).standard_normal((3, 3))
    images = _levels(seen_pictures(scene, shown, None, 120, 160), 7)
    ratios = []
    for sigma in (0.0, 0.01):
        taken = unmixed(images, shown, _response(wrong, sigma))
        found = decode(taken.frames, taken.sequence)
        both = [_off(found, scene, axis) for axis in "uv"]
        ratios.append(np.mean([np.sqrt(np.median((e / s) ** 2) / 0.4549) for e, s in both]))
    assert 0.8 < ratios[1] < 1.2
    assert ratios[0] > 1.1 * ratios[1]


def test_unmixing_is_the_inverse_of_any_mix() -> None:
    rng, shown = np.random.default_rng(2), _packed("gray", "none")
    assert shown.packing is not None
    frames, mix = rng.random((len(shown), 5, 6)), MIX + 0.05 * rng.random((3, 3))
    for own in shown.packing.exposures:
        for i in own:
            frames[i] = frames[own[0]] if own.count(i) > 1 else frames[i]
    light = np.stack([np.tensordot(mix, frames[list(own)], 1) for own in shown.packing.exposures])
    dark = np.array([0.02, 0.05, 0.01])
    images = np.rint((dark + 0.8 * np.moveaxis(light, 1, -1) / 1.2) * 65535).astype(np.uint16)
    response = ColourResponse(dark, mix * 0.8 / 1.2, np.zeros((3, 3)), 0.0, np.arange(2.0), np.ones((3, 2)))
    found = unmixed(images, shown, response, bits=16).frames
    np.testing.assert_allclose(found, 4096 + 49152 * frames, atol=4)
    images[2, 1, 1, 0] = 65535
    lost = np.argwhere(unmixed(images, shown, response, bits=16).frames == 65535)
    assert sorted(lost[:, 0]) == sorted(set(shown.packing.exposures[2]))
    assert (lost[:, 1:] == 1).all()


@pytest.mark.parametrize("mosaic", MOSAICS)
def test_planes_are_moved_to_the_centres_of_quads(mosaic: str) -> None:
    """A fringe of seven quads, sampled at each colour's sites, is that of the quads' centres."""
    y, x = np.mgrid[:64, :72]

    def wave(down: np.ndarray, along: np.ndarray) -> np.ndarray:
        return np.asarray(
            np.cos(2 * np.pi * (down / 2 + 0.3) / 9) + np.cos(2 * np.pi * (along / 2 + 0.1) / 7)
        )

    planes = quads(wave(y, x), mosaic)
    centres = wave(2 * y[:32, :36] + 0.5, 2 * x[:32, :36] + 0.5)
    for channel, site in enumerate(sites(mosaic)):
        if channel != 1:  # two greens are averaged: their mean is at the centre
            found = moved(planes[..., channel], site)
            assert np.abs(found - centres)[8:-8, 8:-8].max() < 1e-4


def test_demosaicked_pictures_are_refused_and_planes_are_not() -> None:
    scene, shown = _scene(), _packed("phase:periods=9/10/11", "none")
    light = seen_pictures(scene, shown, None, 120, 160)
    planes = _levels(light, 9)
    unmixed(planes, shown, _response())
    raw = np.stack([planes[:, ::2, ::2, 0], planes[:, ::2, 1::2, 1]], axis=-1).reshape(8, 60, 160)
    low = np.stack([planes[:, 1::2, ::2, 1], planes[:, 1::2, 1::2, 2]], axis=-1).reshape(8, 60, 160)
    raw = np.stack([raw, low], axis=2).reshape(8, 120, 160)
    for code in (cv2.COLOR_BayerRGGB2RGB, cv2.COLOR_BayerRGGB2RGB_EA, cv2.COLOR_BayerRGGB2RGB_VNG):
        images = np.stack([cv2.cvtColor(one, code) for one in raw])
        with pytest.raises(InputError, match=r"demosaicked.*--mosaic, or show grey"):
            unmixed(images, shown, _response())


def test_a_folder_of_pictures_comes_back(tmp_path) -> None:  # type: ignore[no-untyped-def]
    shown, rng = _packed("gray+phase", "bgr"), np.random.default_rng(1)
    images = rng.integers(0, 4096, (shown.exposures, 12, 16, 3)).astype(np.uint16)
    taken = ColourCapture(images, shown, None, np.arange(shown.exposures) / 30, 12)
    taken.save(tmp_path / "c")
    again = ColourCapture.load(tmp_path / "c")
    assert again.sequence == shown
    assert again.bits == 12
    np.testing.assert_array_equal(again.images, images)
    np.testing.assert_array_equal(again.timestamps, taken.timestamps)
    with pytest.raises(InputError, match=r"optolever response --colour"):
        load_capture(tmp_path / "c")
    (tmp_path / "c" / "images" / "001.png").rename(tmp_path / "c" / "images" / "001.jpg")
    toml = tmp_path / "c" / "capture.toml"
    toml.write_text(toml.read_text().replace("001.png", "001.jpg"))
    with pytest.raises(InputError, match=r"001.jpg: is compressed with loss.*or show grey"):
        ColourCapture.load(tmp_path / "c")


@pytest.mark.parametrize(
    ("old", "new", "wrong"),
    [
        ('stripes = "rgb"', 'stripes = "gbr"', "stripes is 'gbr'"),
        ("[colour]", "[colours]", "unknown field 'colours'"),
        ("bits = 8", "bits = 7", "bits is 7"),
        ("version = 2", "version = 3", "version is 3"),
    ],
)
def test_a_wrong_description_is_one_line(old: str, new: str, wrong: str, tmp_path) -> None:  # type: ignore[no-untyped-def]
    shown = _packed("gray+phase", "rgb")
    ColourCapture(np.zeros((shown.exposures, 4, 4, 3), np.uint8), shown).save(tmp_path / "c")
    toml = tmp_path / "c" / "capture.toml"
    assert old in toml.read_text()
    toml.write_text(toml.read_text().replace(old, new))
    with pytest.raises(InputError, match=wrong) as caught:
        load_capture(tmp_path / "c", colours=_response())
    assert str(toml) in str(caught.value)
    assert "\n" not in str(caught.value)
