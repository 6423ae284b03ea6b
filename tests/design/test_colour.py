"""Codes in colour beside grey ones: predicted as simulated, ranked by as many pictures."""

import pytest

from optolever.design import Candidate, Lever, candidates, compare_codes, in_colour, predict
from optolever.patterns import sequence_from_text
from optolever.samples import Faults
from optolever.scene import dent, load, resize

GREY, COLOUR = "phase:periods=9/10/11", "phase:periods=9/10/11 --colour rgb"


@pytest.mark.slow
@pytest.mark.parametrize("text", ["gray+phase", "phase:periods=9/10/11"])
def test_predicted_height_error_in_colour_is_that_of_a_simulation(text: str) -> None:
    scene = resize(load("prism48", exact=True), 72, 96)
    lever = Lever(scene, dent("gaussian", scene, peak=0.3, sigma=8))
    grey = Candidate(text, sequence_from_text(text, scene.pattern.rows, scene.pattern.cols))
    (colour,) = in_colour([grey], "rgb")
    told = lever.height(predict(lever.view, colour.sequence, 1.0))
    found = lever.simulate(colour, 1.0, range(8), "numpy")
    assert told.total == pytest.approx(found.error, rel=0.2)
    assert found.share == pytest.approx(told.share, abs=0.01)
    assert 0.7 < found.ratio < 1.3


def test_a_budget_of_pictures_holds_three_times_the_frames() -> None:
    found = list(in_colour(candidates(96, 128, 24), "none", 8))
    assert {one.sequence.exposures for one in found} == {6, 8}
    assert max(len(one.sequence) for one in found) == 24
    assert not list(in_colour(candidates(96, 128, 24), "unknown", 5))


def test_codes_are_compared_in_grey_and_in_colour() -> None:
    scene = resize(load("prism48", exact=True), 48, 64)
    rows = compare_codes(scene, "gaussian:peak=0.2", (GREY, "lattice"), faults=(Faults(),), noises=(1.0,),
                         seeds=range(4), colour="rgb", renderer="numpy")  # fmt: skip
    by = {row.code: row for row in rows}
    assert set(by) == {GREY, COLOUR, "lattice"}
    assert (by[GREY].frames, by[COLOUR].frames) == (24, 8)
    assert 0.8 < by[COLOUR].simulated / by[GREY].simulated < 1.6
    assert 0.7 < by[COLOUR].ratio < 1.3
