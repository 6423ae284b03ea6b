"""The decoder's benchmark runs and gives its figures; how fast it is, is not a matter of tests."""

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from optolever.decode import decode
from optolever.experiments import decode_speed, run_decode_figures
from optolever.experiments.speed_frames import (
    SPEED_CODES,
    SpeedCode,
    smooth_map,
    speed_frames,
    speed_sequence,
)

SIZE = (40, 64)
#: On which 40 fringes have periods of more than four cells.
LARGER = (180, 240)


@pytest.mark.slow
def test_every_code_has_its_row() -> None:
    """Ratio and time of each; what is decoded is good."""
    figures = run_decode_figures(size=SIZE, parts=("codes",))
    assert [f.name for f in figures] == [f"{code.name}, decode over floor" for code in SPEED_CODES]
    for figure in figures:
        assert 0 < figure.value < math.inf
        assert "ns per frame and pixel" in figure.note


@pytest.mark.parametrize(
    "code",
    [SPEED_CODES[0], *(pytest.param(code, marks=pytest.mark.slow) for code in SPEED_CODES[1:])],
    ids=lambda code: code.name,
)
def test_frames_show_the_smooth_map(code: SpeedCode) -> None:
    """Most pixels are decoded, to within a cell and a half of where they look."""
    shown = speed_sequence(code, LARGER)
    found = decode(speed_frames(shown, LARGER, code.noise), shown)
    u, v = smooth_map(LARGER, (shown.rows, shown.cols))
    good = found.good
    assert good.mean() > 0.5
    assert max(np.abs(found.u - u)[good].max(), np.abs(found.v - v)[good].max()) < 1.5


def test_floor_writes_as_much_as_decode(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[int] = []

    def counted(start: int, stop: int, frames: Any, maps: Any, flags: Any) -> None:
        written.extend(one[start:stop].nbytes for one in (*maps, flags))

    shown = speed_sequence(SPEED_CODES[0], SIZE)
    frames = speed_frames(shown, SIZE, 1.0)
    monkeypatch.setattr(decode_speed, "_touch", counted)
    decode_speed.toucher(frames)()
    found = decode(frames, shown)
    maps = (getattr(found, field.name) for field in fields(found) if field.name != "notices")
    assert sum(written) == sum(one.nbytes for one in maps)


def test_errors_beside_others() -> None:
    """Errors are those of the noise put in."""
    figures = {f.name: f.value for f in run_decode_figures(size=SIZE, parts=("fringes", "gray"))}
    bound = decode_speed.PERIODS[-1] / (2 * np.pi) * np.sqrt(2 / decode_speed.STEPS)
    bound *= decode_speed.NOISE / decode_speed.AMPLITUDE
    assert figures["16 phase frames, optolever, rms error"] == pytest.approx(bound, rel=0.1)
    assert figures["24 Gray frames, cv2 over optolever"] > 0
    assert figures["24 Gray frames, optolever, rms error"] < 1


def test_fringes_stands_in_both_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its compiler takes 20 s: a stand-in with its interface, which knows the answer."""
    u, v = smooth_map(SIZE, SIZE)

    class Decoded:
        x = np.stack([u, v])[..., None]

    class Coder:
        def decode(self, frames: Any, verbose: bool = False) -> Decoded:
            assert frames.shape == (16, *SIZE, 1)
            return Decoded()

    monkeypatch.setattr(decode_speed, "find_spec", lambda name: name)
    monkeypatch.setattr(decode_speed, "fringes_coder", lambda shown: Coder())
    figures = {f.name: f for f in run_decode_figures(size=SIZE, parts=("fringes",))}
    for mode in ("fringes", "fringes verbose"):
        assert figures[f"16 phase frames, {mode} over optolever"].value > 0
        assert "flags" in figures[f"16 phase frames, {mode}"].note
    assert figures["16 phase frames, fringes, rms error"].value == 0
