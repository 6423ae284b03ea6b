"""Mirrors cut out of an image that they fill: masks, what is around them, and the verdict relative to it."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from lab.hard import hard_surroundings as hard
from lab.hard.hard_case import Case, run_case
from lab.hard.hard_surroundings import AROUND, FORMS, surrounded
from optolever.decode import Correspondence, Flag

SIZE = (64, 80)
ONE = hard.Surroundings("gray+phase", 1.0, 0.3, "round", "dark", "prism48")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("fill", hard.FILLS)
def test_masks_fill_what_they_should(form: str, fill: float) -> None:
    for seed in range(5):
        mask = FORMS[form](fill, SIZE, np.random.default_rng(seed))
        assert mask.mean() == pytest.approx(fill, rel=0.12)
        assert ndimage.label(mask)[1] == (2 if form == "islands" else 1)


@pytest.mark.parametrize("around", AROUND)
def test_only_what_is_around_changes(around: str) -> None:
    rng = np.random.default_rng(1)
    light = rng.random((5, *SIZE)).astype(np.float32)
    mask = FORMS["round"](0.1, SIZE, rng)
    made = surrounded(light, mask, around, np.random.default_rng(2))
    assert (made[:, mask] == light[:, mask]).all()
    outside = made[:, ~mask]
    constant = {"dark", "room", "lamp"}
    assert (np.ptp(outside, axis=0).max() == 0) == (around in constant)
    assert (outside.max() > 1) == (around == "lamp")
    if around == "reflection":
        assert outside.max() <= 0.04
    if around == "room":
        assert outside.std() > 0.1


@pytest.fixture
def case() -> Iterator[Case]:
    """Any, whose answer is made up."""
    hard._alone.cache_clear()
    yield next(hard.surroundings_cases((48, 48)))
    hard._alone.cache_clear()


def fake_decoder(
    monkeypatch: pytest.MonkeyPatch, noise: float = 0.02, bias: float = 0.0, flagged: float = 0.0
) -> None:
    """A decoder that knows the truth; on images that a mirror does not fill it is off, or flags some more."""
    _, area = hard._area("prism48", (48, 48))
    u, v = area.mean()
    draws = np.random.default_rng(0).standard_normal(u.shape) * noise
    more = np.random.default_rng(1).random(u.shape) < flagged

    def decode(frames: Any, shown: Any) -> Correspondence:
        part = float(np.median(np.ptp(frames, axis=0))) < 50
        lit = np.ptp(frames, axis=0) > 50
        flags = np.where(lit & ~(more if part else False), 0, int(Flag.DARK)).astype(np.uint16)
        sigma = np.full(u.shape, noise)
        return Correspondence(u + draws + (bias if part else 0.0), v, sigma, sigma, flags)

    monkeypatch.setattr(hard, "decode", decode)


@pytest.mark.parametrize(
    ("bias", "flagged", "verdict"),
    [
        (0.0, 0.0, "good"),
        (1.0, 0.0, "silent errors"),
        (0.03, 0.0, "worse than alone"),
        (0.0, 0.2, "worse than alone"),
    ],
)
def test_a_decoder_that_surroundings_mislead_fails(
    case: Case, monkeypatch: pytest.MonkeyPatch, bias: float, flagged: float, verdict: str
) -> None:
    fake_decoder(monkeypatch, 0.02, bias, flagged)
    found = hard._decoded(replace(ONE, sequence="phase"), (48, 48))
    assert run_case(replace(case, make=lambda: found)).verdict == verdict
