"""The constant of a component where its integrating factor is tiny or nothing at the anchors."""

from types import SimpleNamespace

import numpy as np
import pytest

from optolever import InputError
from optolever.reconstruct.gauge import free_constants

ROWS = SimpleNamespace(component=np.array([1, 1]))


def test_a_tiny_factor_divides_by_nothing() -> None:
    factor = np.array([1e-200, 2e-200])
    constants, share = free_constants(ROWS, 3.0 * factor, factor, np.ones(2), 1)  # type: ignore[arg-type]
    assert constants == pytest.approx([0.0, -3.0])
    assert share == pytest.approx([0.2, 0.8])


@pytest.mark.parametrize("factor", [0.0, np.nan])
def test_a_factor_of_nothing_is_refused_in_a_line(factor: float) -> None:
    with pytest.raises(InputError, match="anchor: its error would grow"):
        free_constants(ROWS, np.ones(2), np.full(2, factor), np.ones(2), 1)  # type: ignore[arg-type]
