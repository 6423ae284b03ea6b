"""Captures that were once decoded wrongly without a word, or refused for a false cause (../shared/cases)."""

import numpy as np
import pytest

from optolever.decode import Correspondence, decode
from optolever.projector import Capture

from ..conftest import ROOT

CASES = ROOT.parent / "shared" / "cases"
pytestmark = [
    pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not here"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]


def _decoded(number: str) -> tuple[Correspondence, float]:
    """A case, and the share of its good pixels that are off by more than 5 sigma."""
    capture = Capture.load(CASES / number / "cap")
    found, truth = decode(capture.frames, capture.sequence), np.load(CASES / number / "truth.npz")
    off = np.abs(found.u - truth["u"]) > 5 * found.sigma_u
    off |= np.abs(found.v - truth["v"]) > 5 * found.sigma_v
    return found, float(off[found.good].mean()) if found.good.any() else 0.0


def _told(found: Correspondence) -> str:
    return "; ".join(notice.name for notice in found.notices)


def test_bits_that_the_camera_does_not_resolve_are_no_lost_frames() -> None:
    found, beyond = _decoded("11")
    assert found.good.mean() > 0.85
    assert beyond == 0
    assert "missing" not in _told(found)


@pytest.mark.parametrize(("number", "good", "most"), [("14", 0.84, 1e-4), ("15", 0.84, 1e-4)])
def test_a_window_in_some_frames_is_flagged_where_it_is(number: str, good: float, most: float) -> None:
    found, beyond = _decoded(number)
    assert found.good.mean() > good
    assert beyond <= most
    assert "in part of the picture" in _told(found)


def test_rows_that_roll_are_flagged_from_their_line_on() -> None:
    found, beyond = _decoded("16")
    assert found.good.mean() > 0.55
    assert beyond == 0
    assert "row 45" in _told(found)


@pytest.mark.parametrize(("number", "cause"), [("17", "periods off"), ("23", "black is as bright as white")])
def test_what_contradicts_itself_everywhere_is_refused_with_its_cause(number: str, cause: str) -> None:
    found, _ = _decoded(number)
    assert not found.good.any()
    assert cause in _told(found)
    assert "each other's place" not in _told(found)
