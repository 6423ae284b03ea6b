"""Elastic contacts of known force on traced rigs."""

import pytest

from lab.figures.elastic import elastic_figures, elastic_scores


@pytest.mark.slow
@pytest.mark.daily(1)
@pytest.mark.parametrize("kind", ["dark ball", "cut y = W", "layer unknown"])
def test_forces_are_those_that_press(kind: str) -> None:
    scores = elastic_scores(list(elastic_figures(kind, 1, seed=1)))
    assert scores["force error"] < 0.03
    assert scores["force worst"] < 4
    assert scores["depth worst"] < 4
    assert scores["layers"] == (kind == "layer unknown")
