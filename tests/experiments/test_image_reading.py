"""Codes without fringes and swept stripes: what is predicted of them against captures of the virtual sensor,
which traces rays, blurs and adds noise by itself.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode
from optolever.experiments.design import Lever, predict
from optolever.patterns import Sequence, sequence
from optolever.projector import capture
from optolever.scene import dent, load, resize

DRAWS = 12


def blurred(preset: str, blur: float, form: str = "flat") -> Lever:
    """A small camera before a display of that blur."""
    scene = resize(load(preset), 64, 64)
    scene = replace(scene, pattern=replace(scene.pattern, blur_px=blur))
    return Lever(scene, dent(form, scene), stride=1)


def captured(lever: Lever, shown: Sequence, noise: float) -> list[Correspondence]:
    """What is decoded of it in draws of noise."""
    frames = (
        capture(lever.scene, lever.surface, shown, noise=noise, seed=seed, renderer="numpy").frames
        for seed in range(DRAWS)
    )
    return [decode(some, shown) for some in frames]


def lines(flagged: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Shares of rows and columns."""
    return np.concatenate([flagged.mean(axis=0), flagged.mean(axis=1)])


@pytest.mark.parametrize(
    ("preset", "form", "code", "inverses", "blur", "noise"),
    [
        ("paper-simulation", "flat", "gray", False, 2.0, 1.0),
        ("paper-simulation", "flat", "binary", False, 0.9, 1.0),
        ("prism48", "ridge", "xor-gray", True, 0.48, 3.8),
    ],
)
def test_pixels_are_refused_where_the_decoder_refuses_them(
    preset: str, form: str, code: str, inverses: bool, blur: float, noise: float
) -> None:
    """Also for what neighbours say of each other: the border's shadow, doubtful ones around a pixel."""
    lever = blurred(preset, blur, form)
    shown = sequence(code, lever.scene.pattern.rows, lever.scene.pattern.cols, inverses=inverses)
    told = predict(lever.view, shown, noise)
    seen = np.mean([~one.good for one in captured(lever, shown, noise)], axis=0)
    refused = 1 - (1 - told.u.refused) * (1 - told.v.refused)
    assert 0.02 < seen.mean() < 0.98
    assert refused.mean() == pytest.approx(seen.mean(), abs=0.03)
    assert np.abs(lines(refused) - lines(seen)).mean() < 0.04


def test_errors_and_error_bars_of_bits_are_those_of_a_capture() -> None:
    """In the middle, where all is read."""
    lever = blurred("prism48", 1.0)
    shown = sequence("gray", lever.scene.pattern.rows, lever.scene.pattern.cols, inverses=False)
    told, found = predict(lever.view, shown, 2.0), captured(lever, shown, 2.0)
    inner = lever.inner & np.all([one.good for one in found], axis=0)
    assert inner.mean() > 0.5
    for axis in ("u", "v"):
        there, truth = getattr(told, axis), lever.view.coordinate(axis)
        error = np.stack([getattr(one, axis) - truth for one in found])[:, inner]
        stated = np.stack([getattr(one, f"sigma_{axis}") for one in found])[:, inner]
        unit = np.random.default_rng(3).standard_normal((DRAWS, *truth.shape))
        drawn = np.stack([there.drawn(one) + there.bias for one in unit])[:, inner]
        bars = np.stack([there.stated_for(one) for one in unit])[:, inner]
        assert np.sqrt(np.mean(drawn**2)) == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.05)
        assert np.mean(bars) == pytest.approx(np.mean(stated), rel=0.05)
        # a pixel that noise leads astray says so
        assert np.mean(bars * np.abs(drawn)) == pytest.approx(np.mean(stated * np.abs(error)), rel=0.05)


def test_a_thinned_view_reads_the_pixels_of_the_whole_camera() -> None:
    """Whose neighbours are nearer than the view's own."""
    scene = resize(load("prism48"), 128, 128)
    scene = replace(scene, pattern=replace(scene.pattern, blur_px=0.8))
    whole, thinned = (Lever(scene, dent("raised-cosine", scene), stride=stride).view for stride in (1, 4))
    shown = sequence("xor-gray", scene.pattern.rows, scene.pattern.cols, inverses=True)
    one, other = (predict(view, shown, 2.0) for view in (whole, thinned))
    assert other.measured_share == pytest.approx(one.measured_share, abs=0.03)
    assert 0.5 < other.measured_share < 0.95


def test_masks_are_refused_together() -> None:
    """Draw by draw: a border that is refused in one draw of noise is so along its whole length."""
    lever = blurred("paper-simulation", 0.9)
    shown = sequence("binary", lever.scene.pattern.rows, lever.scene.pattern.cols, inverses=False)
    told = predict(lever.view, shown, 1.0)
    assert told.u.flagged is not None
    half = np.full((2, *told.lit.shape), 0.5)
    left = np.stack([told.left(half, index) for index in range(len(told.u.flagged))])
    assert (left == (told.lit & ~told.u.flagged)).all()
    assert left.mean(axis=0)[told.lit] == pytest.approx(
        ((1 - told.u.refused) * (1 - told.v.refused))[told.lit], abs=1e-9
    )
