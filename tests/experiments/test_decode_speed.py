"""The decoder's benchmark runs and gives its figures; how fast it is, is not a matter of tests."""

import math
from typing import Any

import numpy as np
import pytest

from optolever import InputError
from optolever.experiments import decode_speed, run_decode_figures

SIZE = (40, 64)


def test_figures_are_there() -> None:
    """Ratios are those of the times beside them; errors are those of the noise put in."""
    figures = {f.name: f.value for f in run_decode_figures(size=SIZE, parts=("phase", "gray"))}
    for name in ("16 phase frames", "24 Gray frames"):
        floor, ours = figures[f"{name}, floor"], figures[f"{name}, optolever"]
        assert 0 < floor < math.inf
        assert figures[f"{name}, optolever over floor"] == pytest.approx(ours / floor)
        assert figures[f"{name}, optolever over floor, processor time"] > 0
    assert figures["24 Gray frames, cv2 over optolever"] > 0
    assert 0 < figures["16 phase frames, optolever with the display's cells"] < math.inf
    bound = decode_speed.PERIODS[-1] / (2 * np.pi) * np.sqrt(2 / decode_speed.STEPS)
    bound *= decode_speed.NOISE / decode_speed.AMPLITUDE
    assert figures["16 phase frames, optolever, rms error"] == pytest.approx(bound, rel=0.1)
    assert figures["24 Gray frames, optolever, rms error"] < 1


def test_fringes_stands_in_both_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its compiler takes 20 s: a stand-in with its interface, which knows the answer."""
    u, v = decode_speed._place(SIZE)

    class Decoded:
        x = np.stack([u, v])[..., None]

    class Coder:
        def decode(self, frames: Any, verbose: bool = False) -> Decoded:
            assert frames.shape == (16, *SIZE, 1)
            return Decoded()

    monkeypatch.setattr(decode_speed, "find_spec", lambda name: name)
    monkeypatch.setattr(decode_speed, "_fringes_coder", lambda rows, cols: Coder())
    figures = {f.name: f for f in run_decode_figures(size=SIZE, parts=("fringes",))}
    for mode in ("fringes", "fringes verbose"):
        assert figures[f"16 phase frames, {mode} over optolever"].value > 0
        assert "flags" in figures[f"16 phase frames, {mode}"].note
    assert figures["16 phase frames, fringes, rms error"].value == 0


def test_unknown_part() -> None:
    with pytest.raises(InputError, match="part 'speed' is unknown"):
        run_decode_figures(size=SIZE, parts=("speed",))
