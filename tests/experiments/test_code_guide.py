"""`optolever codes`: what is predicted is what a simulation gives; what is called detected is."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import erfc

from optolever import InputError
from optolever.cli import run
from optolever.decode import decode
from optolever.experiments import code_rows, predict_code, seen
from optolever.experiments.ideal import ideal_level
from optolever.patterns import sequence_from_text

SIZE = (120, 170)


def fringe(period: float, steps: int) -> float:
    """Cramer-Rao of N steps, amplitude 60, noise 2, px."""
    return float(period / (2 * np.pi) * np.sqrt(2 / steps) * 2 / 60)


TOGETHER = sum(fringe(period, 3) ** -2 for period in (20, 22, 25)) ** -0.5


@pytest.mark.parametrize(
    ("name", "sigma"),
    [
        pytest.param("gray", 1 / np.sqrt(12), marks=pytest.mark.slow),
        pytest.param("long-run-gray", 1 / np.sqrt(12), marks=pytest.mark.slow),
        ("phase:steps=4", fringe(16, 4)),
        pytest.param("phase:steps=3,periods=20/22/25", TOGETHER, marks=pytest.mark.slow),
        ("gray+phase", fringe(8, 4)),
    ],
)
def test_predicted_sigma_is_the_bound(name: str, sigma: float) -> None:
    """A cell, evenly; Cramer-Rao."""
    found = predict_code(sequence_from_text(name, *SIZE), 60.0, 2.0)
    assert found[1] == pytest.approx(sigma, rel=0.06)
    assert found[2] < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "above"),
    [
        ("stripe:step=8", 1.06),
        ("spot:step=8", 1.13),
        ("spot:step=16", 1.13),
    ],
)
def test_predicted_sigma_of_sweeps_is_a_bound_that_is_nearly_reached(name: str, above: float) -> None:
    """Fisher's information of raised cosines, light and darkness not known, mean over the middle."""
    shown = sequence_from_text(name, *SIZE)
    v, u = np.mgrid[40:80:0.5, 60:110:0.5]
    level = 2 * 60.0 / 2.0 * np.stack([ideal_level(shown, i, u, v) for i in range(len(shown))])
    told = []
    for axis in (1, 2):
        slope = np.gradient(level, 0.5, axis=axis)
        left = slope - slope.mean(axis=0)
        lit = level - level.mean(axis=0)
        left -= lit * (lit * left).sum(axis=0) / (lit**2).sum(axis=0)
        told.append(np.mean(1 / (left**2).sum(axis=0)) ** 0.5)
    assert 0.97 < predict_code(shown, 60.0, 2.0)[1] / max(told) < above


@pytest.mark.parametrize(("ratio", "name"), [(2.0, "gray+phase:steps=4"), (2.2, "gray")])
def test_rate_of_wrong_bits(ratio: float, name: str) -> None:
    """Levels against their inverses, or against the mean of white and black."""
    shown = sequence_from_text(f"{name}{',' if ':' in name else ':'}axes=u", *SIZE)
    rng = np.random.default_rng(3)
    bits = [frame for frame in shown.frames if frame.bit is not None]
    cell = bits[0].cell_px
    # centres of cells: nearer to their edges the code alone is no better, and the fringe mends it
    u = (rng.integers(2, 160 // cell, (150, 200)) + 0.5) * cell - 0.5
    frames = seen(shown, u, u, 60.0, 60.0 / ratio, rng)
    found = decode(frames, shown, on_cells=False)
    wrong = float((np.abs(found.u - u) > 1.5 * cell).mean())
    noise = 0.5 if any(frame.inverted for frame in bits) else 1.5
    # the last bit leads to the next cell
    expected = max(frame.bit or 0 for frame in bits) * 0.5 * erfc(ratio / np.sqrt(2 * noise))
    assert wrong == pytest.approx(expected, rel=0.25)


def test_surfaces_longer_than_the_periods_tell_apart() -> None:
    """20, 22 and 25 px repeat after 1100: of 1920 px what lies beyond is taken for what lies before."""
    shown = sequence_from_text("phase:steps=4,periods=20/22/25", 200, 1920)
    reach, _, gross, stripe = predict_code(shown, 60.0, 2.0)
    assert (reach, stripe) == (200, 10.0)
    assert gross > 0.2


def test_rows_and_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "codes.json"
    names = ["phase:steps=3", "phase:steps=3,counts=0.9"]
    assert run(["codes", *names, "--size", "120x170", "--json", str(path)]) == 0
    rows = json.loads(path.read_text())["codes"]
    assert [row["name"] for row in rows] == names
    assert rows[0]["frames"] == len(sequence_from_text(names[0], *SIZE))
    assert rows[0]["lost"] == rows[0]["swapped"] == 1.0  # two steps of one period contradict the other period
    assert rows[1]["swapped"] < 1.0  # of one period alone: another mirror
    streams = capsys.readouterr()
    assert names[0] in streams.out
    assert streams.err.splitlines() == [f"{names[0]} 0/2", f"{names[1]} 1/2"]  # progress, on no terminal too


def test_bad_numbers() -> None:
    with pytest.raises(InputError, match="noise is 0"):
        list(code_rows(["gray"], SIZE, 60.0, 0.0))
    with pytest.raises(InputError, match="name is 'grey'"):  # before any code is decoded
        next(code_rows(["gray", "grey"], SIZE, 60.0, 1.0))
