"""The decoder's errors are those that noise allows, and the figures tell if they are not."""

from dataclasses import replace
from typing import Any

import pytest

from optolever.decode import Correspondence, decode
from optolever.experiments import decode_errors, run_decode_figures


@pytest.mark.slow
def test_all_are_met() -> None:
    figures = run_decode_figures(parts=("errors",))
    assert len(figures) == 19
    assert [figure.name for figure in figures if not figure.met] == []


@pytest.mark.slow
def test_error_bars_that_are_too_short_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def short(*args: Any, **kwargs: Any) -> Correspondence:
        found = decode(*args, **kwargs)
        return replace(found, sigma_u=0.9 * found.sigma_u)

    monkeypatch.setattr(decode_errors, "decode", short)
    missed = [figure.name for figure in decode_errors._coverage() if not figure.met]
    assert "phase, within 1 sigma, least" in missed
