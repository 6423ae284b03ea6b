"""Codes whose white is brighter than what the camera can read."""

import pytest

from optolever.decode import Correspondence, decode
from optolever.experiments.metrics import rms
from optolever.patterns import sequence

from .conftest import scores, silent
from .light import COLS, WIDTH, U, photographed


def _decoded(name: str, inverses: bool, brighter: float) -> Correspondence:
    shown = sequence(name, 4, COLS, axes="u", inverses=inverses)
    return decode(photographed(shown, U, WIDTH, 0.4, brighter=brighter), shown)


@pytest.mark.parametrize("brighter", [1.2, 2.0])
@pytest.mark.parametrize("name", ["gray", "binary", "long-run-gray"])
def test_bits_and_inverses_compare_as_ever(name: str, brighter: float) -> None:
    """What their mean is says nothing where white saturates: no pixel is refused for it."""
    found = _decoded(name, True, brighter)
    assert found.good.mean() > 0.97
    assert rms(scores(found, U)) < 1.1


@pytest.mark.parametrize("brighter", [1.2, 1.5, 1.9])
@pytest.mark.parametrize("name", ["gray", "binary", "long-run-gray"])
def test_a_threshold_is_known_within_bounds(name: str, brighter: float) -> None:
    """Without inverses bits are compared with a mean of white and black that saturated white hides."""
    found = _decoded(name, False, brighter)
    assert silent(found, U) == 0
    assert rms(scores(found, U)) < 1.1
    assert [str(one) for one in found.notices if "white saturates" in str(one)]


def test_a_few_highlights_are_no_notice() -> None:
    """Nor is a white that saturates where every bit has its inverse."""
    assert not _decoded("gray", False, 1.0).notices
    assert not _decoded("gray", True, 1.5).notices
