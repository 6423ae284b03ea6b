"""The mix of a display's channels in a camera's, against pictures of a known one."""

import numpy as np
import pytest

from optolever import InputError
from optolever.calibration import load_colours, measure_colours, store_colours
from optolever.patterns import packed, sequence
from optolever.projector import ColourCapture
from optolever.scene import load

_MIX = np.array([[0.80, 0.14, 0.02], [0.10, 0.74, 0.09], [0.03, 0.11, 0.79]])
_DARK = np.array([0.06, 0.05, 0.07])
_GAMMAS = (2.25, 2.2, 2.1)


def _ramp(seed: int = 0, dim_white: float = 0.0, gain: float = 0.9) -> ColourCapture:
    """Pictures with photon noise, the mirror brighter in its middle; dim_white: share by which channels that
    are lit together lose light."""
    shown, rng = packed(sequence("ramp", 8, 8)), np.random.default_rng(seed)
    assert shown.packing is not None
    levels = np.array([frame.level or 0 for frame in shown.frames])[np.array(shown.packing.exposures)] / 255
    light = levels ** np.array(_GAMMAS)
    light = light * (1 - dim_white * light.prod(axis=1, keepdims=True) ** (1 / 3))
    fall = 1 - 0.3 * np.square(np.linspace(-1, 1, 60))
    seen = fall[None, :, None, None] * (light @ _MIX.T)[:, None, None, :] * gain * np.ones((1, 1, 80, 1))
    level = rng.poisson(np.maximum(seen, 0) * 255 * 30) / 30 + 255 * _DARK
    return ColourCapture(np.clip(np.rint(level), 0, 255).astype(np.uint8), shown)


def test_mix_curves_and_dark_are_those_of_the_pictures_within_sigma() -> None:
    """Up to one factor of all, the mirror's."""
    ratios = []
    for seed in range(8):
        found = measure_colours(_ramp(seed))
        scale = found.mix.sum() / _MIX.sum()
        ratios.append((found.mix / scale - _MIX) / (found.mix_sigma / scale))
        assert np.abs(found.dark - _DARK).max() < 5e-4
        for curve, gamma in zip(found.light, _GAMMAS, strict=True):
            np.testing.assert_allclose(curve, (found.levels / 255) ** gamma, atol=2e-3)
        assert np.abs(found.mix / scale - _MIX).max() < 1e-3
    assert 0.05 < np.sqrt(np.mean(np.square(ratios))) < 1.2  # sigma is at least 6 misfits


def test_a_display_that_does_not_add_has_its_error_in_sigma() -> None:
    for share in (0.01, 0.03):
        found = measure_colours(_ramp(1, dim_white=share))
        scale = found.mix.sum() / _MIX.sum()
        error = np.sqrt(np.mean((found.mix / scale - _MIX) ** 2))
        sigma = np.sqrt(np.mean(found.mix_sigma**2)) / scale
        assert 0.3 < error / sigma < 1.2


def test_what_is_no_colour_ramp_is_refused_in_one_line() -> None:
    right = _ramp()
    swapped = right.images.copy()
    swapped[[7, 12]] = swapped[[12, 7]]
    grey = np.repeat(right.images[..., 1:2], 3, axis=-1)
    pressed = packed(sequence("gray+phase", 8, 8))
    cases = [
        (ColourCapture(swapped, right.sequence), "contradict each other"),
        (ColourCapture(grey, right.sequence), "not apart"),
        (_ramp(gain=1.3), "white clips; expose less"),
        (ColourCapture(right.images[: pressed.exposures], pressed), "--sequence ramp --colour"),
        (ColourCapture(right.images[..., 0], right.sequence), "give --mosaic"),
    ]
    for capture, wrong in cases:
        with pytest.raises(InputError, match=wrong) as caught:
            measure_colours(capture)
        assert "\n" not in str(caught.value)


def test_the_response_is_kept_in_the_rig(tmp_path) -> None:  # type: ignore[no-untyped-def]
    rig = tmp_path / "rig.toml"
    load("prism48").save(rig)
    assert load_colours(rig) is None
    found = measure_colours(_ramp())
    store_colours(rig, found)
    again = load_colours(rig)
    assert again is not None
    for name in ("dark", "mix", "mix_sigma", "levels", "light"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    assert (again.misfit, again.mosaic) == (found.misfit, found.mosaic)
    load(rig).save(rig)  # a scene that is saved keeps it
    assert load_colours(rig) is not None
    text = rig.read_text()
    wrongs = [
        ("misfit", "misfits"),
        ("dark = [", "dark = [[1, 2], "),
        ("misfit = ", "mosaic = 'GGRB'\nmisfit = "),
    ]
    for old, new in [*wrongs, ("dark = ", "light_ = ")]:
        rig.write_text(text.replace(old, new))
        with pytest.raises(InputError, match=r"rig.toml: \[colour\].*optolever response --colour") as caught:
            load_colours(rig)
        assert "\n" not in str(caught.value)
