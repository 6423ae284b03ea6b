"""Look-up beside the posterior by brute force: every place of the surface, in float64, by error functions."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode.lookup_kernels import SEARCH
from optolever.decode.lookup_tables import table_of
from optolever.decode.plan import plan
from optolever.patterns import Sequence, sequence

from .light import seen_by_pixels
from .test_lookup import case, free, places, seen

F64 = NDArray[np.float64]
_PER_PX = 64  # places per pattern pixel


@dataclass(frozen=True)
class Posterior:
    """Of each pixel (K,): mean and variance within 1.5 px of the likeliest place, probability elsewhere."""

    mean: F64
    variance: F64
    elsewhere: F64


def posterior(shown: Sequence, frames: F64, width: float, blur: float, variance: float) -> Posterior:
    """frames (N, K): any offset and scale, all places as likely."""
    place = np.arange(0, (shown.cols - 1) * _PER_PX) / _PER_PX
    word = seen_by_pixels(shown, place, width, blur)[:, 0]
    word, y = word - word.mean(axis=0), frames - frames.mean(axis=0)
    told = np.maximum(word.T @ y, 0) / np.sqrt(np.square(word).sum(axis=0))[:, None]
    weight = np.exp(0.5 * (np.square(told) - np.square(told).max(axis=0)) / variance)
    weight /= weight.sum(axis=0)
    near = weight * (np.abs(place[:, None] - place[weight.argmax(axis=0)]) < 1.5)
    mass = near.sum(axis=0)
    mean = place @ near / mass
    return Posterior(mean, (np.square(place[:, None] - mean) * near).sum(axis=0) / mass, 1 - mass)


@pytest.mark.parametrize(("width", "blur"), [(1.0, 0.5), (2.0, 0.3), (0.7, 0.4)])
@pytest.mark.parametrize("noise", [2.0, 6.0])
def test_place_and_variance_are_the_posteriors(width: float, blur: float, noise: float) -> None:
    shown, u = free(120, 9), places(120, width, rows=12)
    frames = seen(shown, u, width, blur, noise)
    wanted = plan(shown)
    table = table_of(shown, wanted, wanted.axes[0], SEARCH, (width, blur))
    found = replace(case(shown, frames, noise), table=table).decoded()
    sure = posterior(shown, frames.reshape(9, -1).astype(np.float64), width, blur, noise**2 + 1 / 12)
    good = (found.error.ravel() < 1e-4) & (sure.elsewhere < 1e-4)
    assert good.mean() > 0.9
    off = (found.coordinate.ravel() - sure.mean) / np.sqrt(sure.variance)
    assert np.quantile(np.abs(off[good]), 0.98) < 0.5
    # wider between sharp edges in strong noise, where the posterior is no normal distribution
    ratio = np.median(found.variance.ravel()[good] / sure.variance[good])
    assert 0.9 < ratio < (1.15 if noise < 3 else 1.4)


def test_other_places_are_as_likely_as_they_are() -> None:
    """Few frames in much noise: the probability of another place is that of the posterior."""
    shown, u = free(120, 6), places(120, 1.0, rows=12)
    frames = seen(shown, u, 1.0, 0.5, 10.0)
    found = case(shown, frames, 10.0).decoded()
    sure = posterior(shown, frames.reshape(6, -1).astype(np.float64), 1.0, 0.5, 100 + 1 / 12)
    assert 0.02 < sure.elsewhere.mean() < 0.5
    assert found.error.mean() == pytest.approx(sure.elsewhere.mean(), rel=0.3)


@pytest.mark.parametrize(("width", "blur"), [(1.0, 0.5), (2.0, 0.3), (0.7, 0.4), (1.0, 0.8)])
def test_footprint_and_blur_are_measured(width: float, blur: float) -> None:
    shown, u = sequence("gray", 4, 150, axes="u"), places(150, width)
    table = case(shown, seen(shown, u, width, blur, 1.0), 1.0, cells=np.rint(u)).table
    assert table.spread == pytest.approx(np.hypot(width / 12**0.5, blur), rel=0.03)
