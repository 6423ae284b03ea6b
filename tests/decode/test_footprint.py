"""Camera pixels that do not fill their pitch: what bends inside of them shifts less."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import Decoder, decode
from optolever.errors import InputError
from optolever.experiments.metrics import rms
from optolever.patterns import Sequence, sequence

from .conftest import F64, scores, silent
from .footprints import centres, footprints, places


def waves(size: float) -> tuple[F64, F64]:
    """Places of the parts of pixels: waves of 20 pixels and so many cells along either axis."""
    row, col = places(96, 120)
    wave = size * (np.sin(np.pi / 10 * col) + np.cos(np.pi / 10 * row))
    return 20 + 1.4 * col + wave, 20 + 1.4 * row - wave


def alone() -> Sequence:
    """Gray and phase without white and black: nothing beside the fringe's contrast tells what blurs it."""
    shown = sequence("gray+phase", 180, 210, inverses=True)
    return replace(shown, frames=tuple(one for one in shown.frames if one.kind not in ("white", "black")))


@pytest.mark.daily(1)
@pytest.mark.parametrize("fill", [0.5, 0.75, 1.0])
@pytest.mark.parametrize("size", [2, 4])
def test_contrast_tells_how_far_pixels_fill_their_pitch(size: float, fill: float) -> None:
    """The variance of what a pixel mixes, fill^2 / 12, as a lens of a negative one."""
    u, v = waves(size)
    shown = sequence("phase", 180, 210, steps=8)
    decoder = Decoder(shown)
    found = decoder.decode(footprints(shown, u, v, noise=0.3, fill=fill))
    assert silent(found, centres(u), centres(v)) == 0
    assert rms(scores(found, centres(u), centres(v))) < 1
    assert decoder.profile is not None
    lens = {row.name: row for row in decoder.profile.effects()}["lens"]
    missed = lens.value - (fill**2 - 1) / 12
    assert abs(missed) < max(3 * lens.sigma, 4e-3)


@pytest.mark.daily(1)
@pytest.mark.parametrize("fill", [0.5, 0.75, 1.0])
def test_where_nothing_tells_it_sigma_holds_it(fill: float) -> None:
    """Told it is taken off; taken for a full pixel it is silently wrong."""
    u, v = waves(4)
    frames = footprints(alone(), u, v, noise=0.3, fill=fill)
    for told, most in ((None, 1.3), (fill, 1.0)):
        found = decode(frames, alone(), footprint=told)
        assert found.good.mean() > 0.99
        assert silent(found, centres(u), centres(v)) == 0
        assert rms(scores(found, centres(u), centres(v))) < most
    if fill == 0.5:
        assert silent(decode(frames, alone(), footprint=1.0), centres(u), centres(v)) > 5e-3


@pytest.mark.parametrize("footprint", [0.0, 1.5, np.nan])
def test_a_footprint_is_no_wider_than_the_pitch(footprint: float) -> None:
    with pytest.raises(InputError, match=f"footprint is {footprint}, must be above 0, 1 at most"):
        decode(np.zeros((24, 4, 4), np.uint8), sequence("phase", 40, 40), footprint=footprint)
